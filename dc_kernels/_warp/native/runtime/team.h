// Threads that work on one world together. The leader runs the world's kernels and opens jobs; members, who come and go
// as they please (serve.h), look for an open one and take parts of it. Who takes a part claims it first, and whoever is
// there claims what is left, so that a job ends whether or not any member comes.
//
// A job is a row of phases: no part of one begins before all parts of the one before have ended. Each takes the part of
// its own number first, and so meets what it has in its caches. Macros: SEATS, the most that there may be of a team.
#if !defined(__CUDA_ARCH__)
typedef unsigned long long Ticks;
const int MOST_PHASES = 64;
struct Team {
    // of the host (runtime/teams.py), before any member comes
    void (*give_way)();       // lets another thread have the core
    void (*sleep)(unsigned);  // for as long as `nap`
    unsigned nap;             // its unit is that of the system
    int size;                 // parts of a phase: as many as threads, the leader among them
    // what take_phases calls: compiled once (lead.h), not into every kernel that shares a loop
    double (*take)(Team*, const void*, double (*)(const void*, int, int), const void*);
    char apart_of_host[32];
    // of the leader
    const void* phases;
    double (*part)(const void*, int, int);
    const void* given;
    Ticks rest_until;  // no job is opened before
    long long job;     // number of the latest, odd while it is open
    char apart_of_leader[24];
    // of all
    int members;  // that are there, beside the leader
    int inside;   // of these, who may look at the job
    char apart_of_members[56];
    int done;  // parts of the job that have ended
    char apart_of_done[60];
    struct Seat {
        long long claimed;  // the latest phase of which somebody took the part with this number
        double largest;     // of what these parts gave
        char apart[48];
    } seat[SEATS];
};
struct Phases {
    int count = 0;
    int first[MOST_PHASES + 1];        // item of each phase, and behind the last
    int parts[MOST_PHASES + 1] = {0};  // of all phases before each, and of all

    // One more phase, up to an item; in parts of not less than so many. No phase where there are no items.
    void add(int end, int size, int least) {
        const int items = end - first[count], most = items / least;
        if (items <= 0) return;
        parts[count + 1] = parts[count] + (most < 1 ? 1 : most < size ? most : size);
        first[++count] = end;
    }
};
// Take all phases: `part` is called with first and last item of each part; the largest number that it gave, or 0.
auto take_phases = [](Team* team, const Phases& phases, auto part) -> double {
    typedef decltype(part) Part;
    auto call = [](const void* given, int first, int last) -> double { return (*(const Part*)given)(first, last); };
    return team->take(team, &phases, call, &part);
};
#endif
