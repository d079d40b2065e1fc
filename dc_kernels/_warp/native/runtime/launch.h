// Launches one after the other, but for those that lack what they need (Activity) in the worlds of a shard. ASLEEP and
// AWAKE are looked for where they may have changed, RESTED when a launch needs it: those before it decide.
// Parameters: launches, begin, end, shard, sleep, active. Returns what is active; -1 where it may have changed, but not
// where nothing is awake.
#if !defined(__CUDA_ARCH__)
struct Launch {
    void (*kernel)(void*, void*);
    void* bounds;
    void* arguments;
    unsigned long long needs;
};
const Launch* const launch = (const Launch*)launches.data;
const int last = shard[0] + shard[1];
int found = active, asleep = active < 0, rested = 0;
for (int i = begin; i < end; ++i) {
    const int needs = (int)launch[i].needs;
    if (needs & RESTED) {
        const int* const waited = (const int*)sleep.data[2];
        int w = shard[0];
        while (w < last && waited[w] <= EVERY) ++w;
        if (w == last) continue;
        rested = 1;
    } else if (needs != 0) {
        if (found < 0) {
            const int *const sleeping = (const int*)sleep.data[0], *const dormant = (const int*)sleep.data[1];
            found = 0;
            for (int w = shard[0]; w < last; ++w) {
                found |= (sleeping[w] | dormant[w]) != 0 ? ASLEEP : 0;
                found |= dormant[w] == 0 ? AWAKE : 0;
            }
            asleep = found & ASLEEP;
        }
        if (needs & ~found) continue;
    }
    launch[i].kernel(launch[i].bounds, launch[i].arguments);
}
return rested || (asleep && found & AWAKE) ? -1 : found;
#else
return -1;
#endif
