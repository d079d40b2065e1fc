// Puts the `found` pairs in pairs.temp_a and temp_b among the first `before` in near_a and near_b, all sorted by (A,
// B); of the latter those are dropped of which a shape has left. Returns how many that makes, also where they have no
// room: near_a and near_b are of no use then. Parameters: w, found, before, model, pairs, near_a, near_b, more_a,
// more_b (scratch). Macro: FEW.
const int first = model.shape_start.data[w], shapes = model.shape_start.data[w + 1] - first;
const int start = pairs.start.data[w], capacity = pairs.start.data[w + 1] - start;
int* const count = pairs.bucket.data + pairs.bucket_start.data[w];
struct List {
    int *a, *b;
};
const List near = {near_a.data + start, near_b.data + start}, more = {more_a.data + start, more_b.data + start};
const List temp = {pairs.temp_a.data + start, pairs.temp_b.data + start};

int kept = 0;
for (int i = 0; i < before; ++i) {
    const int a = near.a[i], b = near.b[i];
    near.a[kept] = a;
    near.b[kept] = b;
    // the level of one that stays is -1
    kept += (pairs.cell.data[a].c[2] & pairs.cell.data[b].c[2]) < 0;
}
if (kept + found > capacity) return kept + found;

// counting sort by A, or by B; what is alike keeps its order
auto distribute = [&](List from, List to, const int* by) {
    for (int i = 0; i <= shapes; ++i) count[i] = 0;
    for (int i = 0; i < found; ++i) ++count[by[i] - first + 1];
    for (int i = 0; i < shapes; ++i) count[i + 1] += count[i];
    for (int i = 0; i < found; ++i) {
        const int slot = count[by[i] - first]++;
        to.a[slot] = from.a[i];
        to.b[slot] = from.b[i];
    }
};
// whether few steps sort pairs, most of which are in order
auto insert = [&](List list) -> bool {
    long long steps = 0, enough = found <= FEW ? FEW * FEW : 8ll * found;
    for (int i = 1; i < found; ++i) {
        const int a = list.a[i], b = list.b[i];
        int k = i;
        for (; k > 0 && (list.a[k - 1] > a || (list.a[k - 1] == a && list.b[k - 1] > b)); --k) {
            list.a[k] = list.a[k - 1];
            list.b[k] = list.b[k - 1];
        }
        list.a[k] = a;
        list.b[k] = b;
        steps += i - k;
        if (steps > enough) return false;
    }
    return true;
};
List fresh = temp;
if (found > FEW) {
    fresh = kept > 0 ? more : near;
    distribute(temp, fresh, temp.a);
    if (!insert(fresh)) {
        distribute(temp, more, temp.b);
        fresh = kept > 0 ? temp : near;
        distribute(more, fresh, more.a);
    }
} else {
    insert(fresh);
}
// merged from the back
for (int i = kept - 1, j = found - 1, k = kept + found - 1; j >= 0 && fresh.a != near.a; --k) {
    const bool old = i >= 0 && (near.a[i] > fresh.a[j] || (near.a[i] == fresh.a[j] && near.b[i] > fresh.b[j]));
    near.a[k] = old ? near.a[i] : fresh.a[j];
    near.b[k] = old ? near.b[i] : fresh.b[j];
    i -= old;
    j -= !old;
}
return kept + found;
