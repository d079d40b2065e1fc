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
// who finds nothing spins for some 50 us, then looks on for forty times as long, which spans what a leader does alone
// between two jobs of a step, and gives way now and then; where that costs the core, or after that time, it sleeps
// between two looks, for longer where no leader opens a job: who wakes often takes a crowded core from those who work,
// and who sleeps comes a hundred microseconds late on a machine that has to be woken itself
const int longer = 8;
auto all_rest = [=]() {
    bool rest = true;
    for (int i = 0; i < count; ++i)
        rest = rest && (__atomic_load_n(&team[i]->closed, __ATOMIC_RELAXED) || Lead::rests(*team[i]));
    return rest;
};
Ticks from = Lead::now(), spun = 0;
const int spins = 1000, looks = 40 * spins, between_yields = 128;
for (int idle = 0; idle < spins + looks + patience && !__atomic_load_n(over.data, __ATOMIC_RELAXED); ++idle) {
    for (int i = 0; i < count; ++i) {
        const long long latest = Lead::follow(*team[i], me[i], known[i]);
        if (latest != known[i]) idle = 0;
        known[i] = latest;
    }
    if (!idle) from = Lead::now();
    if (idle == spins) spun = Lead::now() - from;
    if (idle < spins + looks) {
        Lead::breathe();
        if (idle >= spins && idle % between_yields == 0 && (all_rest() || Lead::is_crowded(*team[0], spun)))
            idle = spins + looks;
    } else {
        team[0]->sleep(all_rest() ? longer * team[0]->nap : team[0]->nap);
    }
}
for (int i = 0; i < count; ++i) __atomic_fetch_sub(&team[i]->members, 1, __ATOMIC_RELEASE);
#endif
