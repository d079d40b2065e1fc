// What threads do that work on one world together: compiled once, and called by the address in Team. Stands behind
// team.h.
#if !defined(__CUDA_ARCH__)
struct Lead {
    static Ticks now() {
#if defined(__x86_64__)
        return __builtin_readcyclecounter();
#elif defined(__aarch64__)
        Ticks count;
        asm volatile("mrs %0, cntvct_el0" : "=r"(count));
        return count;
#else
        return 0;
#endif
    }
    static void breathe() {
#if defined(__x86_64__)
        __builtin_ia32_pause();
#elif defined(__aarch64__)
        asm volatile("yield");
#endif
    }
    // Wait until a number has come up to (sign 1) or down to (-1) another: spin at first, then give way to other
    // threads, then sleep, as one that gives way takes the core from whom it waits for if that has a lower priority. A
    // leader who waits far longer than it worked itself, as somebody has lost the core, rests from jobs for
    // sixteen times as long: a machine with too few cores is then no slower than for one thread by more than a tenth.
    static void wait(Team& team, const int& number, int sign, int other, bool leads, Ticks begun) {
        const int spins = 2000, yields = 2000;
        const Ticks from = leads ? now() : 0;
        for (int i = 0; sign * (__atomic_load_n(&number, __ATOMIC_ACQUIRE) - other) < 0; ++i) {
            if (i < spins) {
                breathe();
                continue;
            }
            if (i < spins + yields)
                team.give_way();
            else
                team.sleep(team.nap);
            if (leads && now() - from > 2 * (from - begun)) team.rest_until = now() + 16 * (now() - from);
        }
    }
    static bool claim(Team& team, int p, long long phase) {
        long long* const claimed = &team.seat[p].claimed;
        long long latest = __atomic_load_n(claimed, __ATOMIC_RELAXED);
        return latest < phase &&
               __atomic_compare_exchange_n(claimed, &latest, phase, false, __ATOMIC_ACQ_REL, __ATOMIC_RELAXED);
    }
    // Take parts of the job of the given number until all have ended. It is not read from the team: the leader may have
    // closed it already.
    static void work(Team& team, int me, long long job) {
        const Phases& phases = *(const Phases*)team.phases;
        const long long before = job * MOST_PHASES;
        for (int k = 0; k < phases.count; ++k) {
            const int parts = phases.parts[k + 1] - phases.parts[k], first = phases.first[k];
            const long long items = phases.first[k + 1] - first;
            const Ticks begun = me ? 0 : now();
            for (int i = 0, p = me % parts; i < parts; ++i, p = p + 1 < parts ? p + 1 : 0) {
                if (!claim(team, p, before + k)) continue;
                const int from = first + (int)(items * p / parts), to = first + (int)(items * (p + 1) / parts);
                const double found = team.part(team.given, from, to);
                if (found > team.seat[p].largest) team.seat[p].largest = found;
                __atomic_fetch_add(&team.done, 1, __ATOMIC_ACQ_REL);
            }
            wait(team, team.done, 1, phases.parts[k + 1], me == 0, begun);
        }
    }
    // Let all take part in a job until it is done; by oneself if nobody is there, or was missed lately, or for so few
    // items that no phase has two parts.
    static double take(Team* given_team, const void* given_phases, double (*part)(const void*, int, int),
                       const void* given) {
        Team& team = *given_team;
        const Phases& phases = *(const Phases*)given_phases;
        const bool missed = team.rest_until && now() <= team.rest_until;
        double largest = 0;
        if (phases.parts[phases.count] == phases.count || !__atomic_load_n(&team.members, __ATOMIC_RELAXED) || missed) {
            for (int k = 0; k < phases.count; ++k) {
                const double found = part(given, phases.first[k], phases.first[k + 1]);
                if (found > largest) largest = found;
            }
            return largest;
        }
        team.phases = &phases;
        team.part = part;
        team.given = given;
        team.done = 0;
        for (int p = 0; p < team.size; ++p) team.seat[p].largest = 0;
        __atomic_store_n(&team.job, team.job + 1, __ATOMIC_RELEASE);
        const Ticks begun = now();
        work(team, 0, team.job);
        __atomic_store_n(&team.job, team.job + 1, __ATOMIC_SEQ_CST);
        wait(team, team.inside, -1, 0, true,
             begun);  // whoever is still inside may read what lies on the leader's stack
        for (int p = 0; p < team.size; ++p)
            if (team.seat[p].largest > largest) largest = team.seat[p].largest;
        return largest;
    }
    // Take part in the open job unless it is the one of the given number; the number of the latest.
    static long long follow(Team& team, int me, long long known) {
        const long long open = __atomic_load_n(&team.job, __ATOMIC_ACQUIRE);
        if (!(open & 1) || open == known) return known;
        __atomic_fetch_add(&team.inside, 1, __ATOMIC_SEQ_CST);
        if (__atomic_load_n(&team.job, __ATOMIC_SEQ_CST) == open) work(team, me, open);
        __atomic_fetch_sub(&team.inside, 1, __ATOMIC_RELEASE);
        return open;
    }
};
#endif
