// Take part in the jobs of teams until `over` says that there will be none, or so many naps found none. Stands behind
// lead.h. Parameters: teams (their addresses), over, patience.
#if !defined(__CUDA_ARCH__)
long long known[SEATS];
int me[SEATS];
const int count = teams.shape[0];
Team* const* const team = (Team* const*)teams.data;
for (int i = 0; i < count; ++i) {
    known[i] = 0;
    me[i] = __atomic_add_fetch(&team[i]->members, 1, __ATOMIC_ACQ_REL);
}
// who finds nothing spins for some 50 us, gives way for as long, and then sleeps between two looks, for longer where no
// leader opens a job: who wakes often takes a crowded core from those who work
const int longer = 8;
Ticks from = Lead::now(), spun = 0;
const int spins = 1000, yields = 100;
for (int idle = 0; idle < spins + yields + patience && !__atomic_load_n(over.data, __ATOMIC_RELAXED); ++idle) {
    for (int i = 0; i < count; ++i) {
        const long long latest = Lead::follow(*team[i], me[i], known[i]);
        if (latest != known[i]) idle = 0;
        known[i] = latest;
    }
    if (!idle) from = Lead::now();
    if (idle < spins)
        Lead::breathe();
    else if (idle < spins + yields) {
        if (idle == spins) spun = Lead::now() - from;
        if (Lead::is_crowded(*team[0], spun)) idle = spins + yields;
    } else {
        bool rest = true;
        for (int i = 0; i < count; ++i)
            rest = rest && (__atomic_load_n(&team[i]->closed, __ATOMIC_RELAXED) || Lead::rests(*team[i]));
        team[0]->sleep(rest ? longer * team[0]->nap : team[0]->nap);
    }
}
for (int i = 0; i < count; ++i) __atomic_fetch_sub(&team[i]->members, 1, __ATOMIC_RELEASE);
#endif
