// Rounds in which no world of a shard is awake, all at once: nothing but the time of worlds without flags goes on.
// Parameters: rounds, shard, flags, sleep (behind three other addresses those of time and step_dt, and the bytes of a
// number of the latter), halt. Returns the rounds passed, fewer where another shard halts.
#if !defined(__CUDA_ARCH__)
const int first = shard[0], last = first + shard[1];
double* const time = (double*)sleep.data[3];
auto pass = [&](const auto* dt) {
    int passed = 0;
    for (; passed < rounds && !__atomic_load_n(halt.data, __ATOMIC_RELAXED); ++passed)
        for (int w = first; w < last; ++w) time[w] = flags.data[w] ? time[w] : time[w] + (double)dt[w];
    return passed;
};
return sleep.data[5] == sizeof(float) ? pass((const float*)sleep.data[4]) : pass((const double*)sleep.data[4]);
#else
return rounds;
#endif
