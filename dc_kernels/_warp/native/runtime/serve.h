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
// who finds nothing spins for some 50 us, gives way for as long, and then sleeps between two looks
const int spins = 1000, yields = 100;
for (int idle = 0; idle < spins + yields + patience && !__atomic_load_n(over.data, __ATOMIC_RELAXED); ++idle) {
    for (int i = 0; i < count; ++i) {
        const long long latest = Lead::follow(*team[i], me[i], known[i]);
        if (latest != known[i]) idle = 0;
        known[i] = latest;
    }
    if (idle < spins)
        Lead::breathe();
    else if (idle < spins + yields)
        team[0]->give_way();
    else
        team[0]->sleep(team[0]->nap);
}
for (int i = 0; i < count; ++i) __atomic_fetch_sub(&team[i]->members, 1, __ATOMIC_RELEASE);
#endif
