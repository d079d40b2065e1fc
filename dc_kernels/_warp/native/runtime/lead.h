// What threads do that work on one world together: compiled once, and called by the address in Team. Stands behind
// team.h. Macro: TEAM_BYTES.
#if !defined(__CUDA_ARCH__)
static_assert(sizeof(Team) <= TEAM_BYTES, "the host reserves TEAM_BYTES for a team");
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
    struct Job {
        Phases phases;
        double (*part)(const void*, int, int);
        const void* given;
        long long number;
    };
    // Take part p of a phase unless somebody has; whether it was taken. The parts of a phase are numbered on from
    // those of the phases before, `number`.
    static bool take_part(Team& team, const Job& job, int k, int p, long long number) {
        Team::Seat& seat = team.seat[p];
        long long latest = __atomic_load_n(&seat.claimed, __ATOMIC_RELAXED);
        if (latest >= number ||
            !__atomic_compare_exchange_n(&seat.claimed, &latest, number, false, __ATOMIC_ACQ_REL, __ATOMIC_RELAXED))
            return false;
        const Phases& phases = job.phases;
        const Share share(&team, phases.first[k], phases.first[k + 1] - phases.first[k], phases.split[k], p,
                          phases.parts[k + 1] - phases.parts[k]);
        double found = 0;
        for (int i = 0; i < 2; ++i) {
            if (share.first[i] == share.last[i]) continue;
            const double here = job.part(job.given, share.first[i], share.last[i]);
            if (here > found) found = here;
        }
        if (seat.job != job.number) {
            seat.job = job.number;
            seat.largest = 0;
        }
        if (found > seat.largest) seat.largest = found;
        __atomic_store_n(&seat.ended, number, __ATOMIC_RELEASE);
        return true;
    }
    // Let another thread have the core, once; whether that kept it for longer than it took to spin before. To give way
    // again would then cost a slice of time each time, where who has slept is let in soon.
    static bool is_crowded(Team& team, Ticks spun) {
        const Ticks from = now();
        team.give_way();
        return now() - from > spun;
    }
    // Wait until part p of a phase has ended, and take it where nobody has for as long as the own parts took: spin at
    // first, then give way to other threads, then sleep, as one that gives way takes the core from whom it waits for if
    // that has a lower priority. A leader who waits far longer than it worked itself, as somebody has lost the core,
    // rests from jobs. Whether the part was taken here.
    static bool wait(Team& team, const Job& job, int k, int p, long long number, bool leads, Ticks begun) {
        const int least = 50, spins = 2000, yields = 2000;
        const Ticks from = now();
        Ticks spun = 0;
        bool asked = false, missed = false;
        for (int i = 0; __atomic_load_n(&team.seat[p].ended, __ATOMIC_ACQUIRE) < number; ++i) {
            if (!asked && i >= least && now() - from > from - begun) {
                asked = true;
                if (take_part(team, job, k, p, number)) return true;
            }
            if (i < spins) {
                breathe();
                continue;
            }
            if (i == spins) spun = now() - from;
            if (i >= spins + yields)
                team.sleep(team.nap);
            else if (is_crowded(team, spun))
                i = spins + yields;
            missed = leads && now() - from > 2 * (from - begun);
        }
        if (missed) rest(team, now() - from);
        return false;
    }
    // Open no job for as long as somebody was waited for; where he had not been there for sixteen times as long before,
    // as others keep the cores busy, for sixteen times as long, and for twice as long as the last time, up to a
    // thousand times: a machine with too few cores is then hardly slower than for one thread, and one that is disturbed
    // now and then hardly slower than if it were not.
    static void rest(Team& team, Ticks waited) {
        const Ticks time = now(), least = 16 * waited, most = 1024 * waited;
        if (time >= team.rest_until) {  // else in a job in which somebody was missed already
            const Ticks twice = 2 * team.rest < most ? 2 * team.rest : most;
            const bool soon = time - team.rest_until < least;
            team.rest = !soon ? waited : twice > least ? twice : least;
        }
        __atomic_store_n(&team.rest_until, time + team.rest, __ATOMIC_RELAXED);
    }
    // Take parts of a job until all have ended; members may leave before the last have. Of the first phase each takes
    // what is left, of others the own part and those that it took of the phase before.
    static void work(Team& team, const Job& job, int me) {
        unsigned long long taken = ~0ull;
        for (int k = 0; k < job.phases.count; ++k) {
            const int parts = job.phases.parts[k + 1] - job.phases.parts[k];
            const long long number = job.number * MOST_PHASES + k;
            const unsigned long long mine = taken | (me < SEATS ? 1ull << me : 0);
            const Ticks begun = now();
            taken = 0;
            for (int i = 0, p = me % parts; i < parts; ++i, p = p + 1 < parts ? p + 1 : 0)
                if (mine >> p & 1 && take_part(team, job, k, p, number)) taken |= 1ull << p;
            // of those who are as many as the parts, each with its own, it is known how fast they are
            if (parts == team.size && me < parts && taken == 1ull << me) {
                team.seat[me].spent += now() - begun;
                ++team.seat[me].phases;
            }
            if (me && k + 1 == job.phases.count) return;
            for (int p = 0; p < parts; ++p)
                if (!(taken >> p & 1) && wait(team, job, k, p, number, me == 0, begun)) taken |= 1ull << p;
        }
    }
    // Whether the next job finds a member.
    static bool is_there(Team* team) {
        return __atomic_load_n(&team->members, __ATOMIC_RELAXED) && !team->closed && !rests(*team);
    }
    // Whether no job is opened now, as somebody was missed.
    static bool rests(const Team& team) {
        const Ticks end = __atomic_load_n(&team.rest_until, __ATOMIC_RELAXED);
        return end && now() < end;
    }
    // Let all take part in a job until it is done; by oneself if nobody is there, or was missed lately, or for so few
    // items that no phase has two parts.
    static double take(Team* given_team, const void* given_phases, double (*part)(const void*, int, int),
                       const void* given) {
        Team& team = *given_team;
        const Phases& phases = *(const Phases*)given_phases;
        double largest = 0;
        if (phases.parts[phases.count] == phases.count || !is_there(&team)) {
            for (int k = 0; k < phases.count; ++k) {
                const double found = part(given, phases.first[k], phases.first[k + 1]);
                if (found > largest) largest = found;
            }
            return largest;
        }
        const Job job = {phases, part, given, team.job + 1};
        team.phases = &job.phases;
        team.part = part;
        team.given = given;
        __atomic_store_n(&team.job, job.number, __ATOMIC_RELEASE);
        work(team, job, 0);
        // members who still look at it find nothing left to take; who comes later must see that it is closed before
        // anything of the next one is written
        __atomic_store_n(&team.job, job.number + 1, __ATOMIC_RELEASE);
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
        for (int p = 0; p < team.size; ++p)
            if (team.seat[p].job == job.number && team.seat[p].largest > largest) largest = team.seat[p].largest;
        return largest;
    }
    // Segments of the items of a world's first colours, so many a block, which are summed up in pieces of that length:
    // by whose share of a colour they are, a few by who has those before.
    static void make_plan(Team* team, const int* ends, int colors, int per_block, int length, Plan* made) {
        const int size = team->size, most = sizeof(made->segment) / sizeof(made->segment[0]), few = 32 * per_block;
        const int begin = ends[0] * per_block, behind = ends[colors] * per_block;
        Plan::Segment* const segment = made->segment;
        int count = 0, piece = 0, end = begin, end_of_piece = begin + length;
        auto give = [&](int owner, int last) {
            if (count > 0 && last - end < few) owner = segment[count - 1].owner;
            while (end < last && count < most) {
                const int until = last < end_of_piece ? last : end_of_piece;
                if (count > 0 && segment[count - 1].piece == piece && segment[count - 1].owner == owner)
                    segment[count - 1].last = until;
                else
                    segment[count++] = {end, until, (short)owner, (short)piece, -1};
                end = until;
                if (end == end_of_piece) {
                    ++piece;
                    end_of_piece += length;
                }
            }
        };
        for (int k = 0; k < colors; ++k) {
            const int blocks = ends[k + 1] - ends[k];
            if (blocks == 0) continue;
            const int fixed = team->split[k] < blocks ? team->split[k] : blocks;
            for (int p = 1; p <= size; ++p)
                give(p - 1, Share::begin(team, ends[k], ends[k] + fixed, p, size) * per_block);
            for (int p = 1; p <= size; ++p)
                give(p - 1, Share::begin(team, ends[k] + fixed, ends[k + 1], p, size) * per_block);
        }
        made->count = end == behind ? give_turns(*made, count, size, (behind - begin) / (8 * size)) : 0;
    }
    // The plan that make_plan makes; that of before where it would be equal.
    static const Plan* find_plan(Team* team, const int* ends, int colors, int per_block, int length) {
        const int sizes[] = {colors, per_block, length};
        bool same = true;
        auto take = [&same](int& known, int given) {
            same &= known == given;
            known = given;
        };
        for (int k = 0; k < 3; ++k) take(team->sizes[k], sizes[k]);
        for (int k = 0; k <= colors; ++k) take(team->ends[k], ends[k]);
        for (int k = 0; k < colors; ++k) take(team->splits[k], team->split[k]);
        for (int p = 1; p < team->size; ++p) take(team->begins[p], team->begin[p]);
        if (!same) make_plan(team, ends, colors, per_block, length, &team->made);
        return &team->made;
    }
    // Turns of segments: those of a piece one after the other, and of each thread as many in a turn as the longest that
    // any has to take, or some items. The number of segments, or 0 where they take too many turns.
    static int give_turns(Plan& plan, int count, int size, int some) {
        Plan::Segment* const segment = plan.segment;
        int turn = 0;
        auto items = [&](int k) { return segment[k].last - segment[k].first; };
        auto is_ready = [&](int k, int p) {
            if (segment[k].turn >= 0 || segment[k].owner != p) return false;
            if (k == 0 || segment[k - 1].piece != segment[k].piece) return true;
            return segment[k - 1].turn >= 0 && segment[k - 1].turn < turn;
        };
        for (int left = count; left > 0; ++turn) {
            if (turn == MOST_PHASES) return 0;
            int enough = some;
            for (int p = 0; p < size; ++p)
                for (int k = 0; k < count; ++k)
                    if (is_ready(k, p)) {
                        if (items(k) > enough) enough = items(k);
                        break;
                    }
            for (int p = 0; p < size; ++p) {
                int taken = 0;
                for (int k = 0; k < count; ++k) {
                    if (!is_ready(k, p) || taken + items(k) > enough) continue;
                    segment[k].turn = (short)turn;
                    taken += items(k);
                    --left;
                }
            }
        }
        plan.turns = turn;
        return count;
    }
    // Take part in the open job unless it is the one of the given number; the number of the latest. What it reads lies
    // on the leader's stack, and is only what it was where the job is open afterwards.
    static long long follow(Team& team, int me, long long known) {
        const long long open = __atomic_load_n(&team.job, __ATOMIC_ACQUIRE);
        if (!(open & 1) || open == known) return known;
        auto read = [](const int& number) { return __atomic_load_n(&number, __ATOMIC_RELAXED); };
        const Phases& phases = *(const Phases*)__atomic_load_n(&team.phases, __ATOMIC_RELAXED);
        Job job;
        job.number = open;
        job.part = __atomic_load_n(&team.part, __ATOMIC_RELAXED);
        job.given = __atomic_load_n(&team.given, __ATOMIC_RELAXED);
        job.phases.count = read(phases.count);
        if (job.phases.count < 1 || job.phases.count > MOST_PHASES) return known;
        for (int k = 0; k <= job.phases.count; ++k) {
            job.phases.first[k] = read(phases.first[k]);
            job.phases.parts[k] = read(phases.parts[k]);
            if (k < job.phases.count) job.phases.split[k] = read(phases.split[k]);
        }
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (__atomic_load_n(&team.job, __ATOMIC_RELAXED) != open) return known;
        work(team, job, me);
        return open;
    }
};
#endif
