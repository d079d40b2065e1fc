// Threads that work on one world together. The leader runs the world's kernels and opens jobs; members, who come and go
// as they please (serve.h), look for an open one and take parts of it. Who takes a part claims it first, and whoever is
// there claims what is left, so that a job ends whether or not any member comes.
//
// A job is a row of phases: no part of one begins before all parts of the one before have ended. Each takes the part of
// its own number first, and so meets what it has in its caches. What one core writes takes far longer to reach another
// than a part may take, so nobody looks at what belongs to another part before it must: whether it has ended, and, if
// that takes long, whether somebody has claimed it. Macros: SEATS, the most that there may be of a team.
#if !defined(__CUDA_ARCH__)
typedef unsigned long long Ticks;
const int MOST_PHASES = 64;
// Who sums up what of the items of a world's rows, in order: which thread, into which piece's sum, in which turn of
// that.
struct Plan {
    struct Segment {
        int first, last;
        short owner, piece, turn;
    };
    int count = 0, turns = 0;  // no segments: one thread sums up all
    Segment segment[512];
};
struct Team {
    // of the host (runtime/sequences.py), before any member comes
    void (*give_way)();       // lets another thread have the core
    void (*sleep)(unsigned);  // for as long as `nap`
    unsigned nap;             // its unit is that of the system
    int size;                 // parts of a phase: as many as threads, the leader among them
    // what take_phases, is_helped and sum_rows call: compiled once (lead.h), not into every kernel that shares a loop
    double (*take)(Team*, const void*, double (*)(const void*, int, int), const void*);
    bool (*is_there)(Team*);
    int closed;  // not 0: no job is opened
    const Plan* (*plan)(Team*, const int*, int, int, int);
    char apart_of_host[8];
    // of the host, changed between two launches: where the part of each thread but the first begins, in 65536ths of the
    // items of a phase, as cores differ in speed
    int begin[SEATS];
    // of the leader
    const void* phases;
    double (*part)(const void*, int, int);
    const void* given;
    Ticks rest_until;  // no job is opened before
    long long job;     // number of the latest, odd while it is open
    Ticks rest;        // for so long was none opened the last time that somebody was missed
    int counted;       // parts whose contacts are counted in `count`, 0: they are not
    char apart_of_leader[12];
    // of all
    int members;  // that are there, beside the leader
    char apart_of_members[60];
    struct Seat {
        long long claimed;  // the latest phase of which somebody took the part with this number
        char apart[56];
        long long ended;  // the latest phase of which that part has ended
        long long job;    // the latest of which `largest` is told
        double largest;   // of what these parts gave
        char apart_of_ended[40];
        // of who takes the parts of this number: in so many phases in which it took no others, for so long
        Ticks spent;
        long long phases;
        char apart_of_spent[48];
    } seat[SEATS];
    // of the leader: blocks of each colour before which bodies A do not move, or else do (pack/contacts.h): whom ground
    // and walls are in contact with is everywhere, so that threads share these blocks, and the others, each by place
    int split[MOST_PHASES];
    // contacts of each colour in each part of a world's contacts (pack/lay_out.h)
    int count[SEATS][MOST_PHASES];
    // of what the last plan was made, as those of the sweeps of a solve are one
    int ends[MOST_PHASES + 1], splits[MOST_PHASES], sizes[3], begins[SEATS];
    Plan made;
};
// What belongs to part p of so many parts of `items` from `begin` on, of which so many in front are of the first kind:
// from first[i] to last[i] of either kind.
struct Share {
    int first[2], last[2];
    // Where part p of so many parts of the items from..to begins, whose kinds are all one: as fast as threads are where
    // each has a part, and else as many for each.
    static int begin(const Team* team, int from, int to, int p, int parts) {
        const long long items = to - from;
        if (parts == team->size && p > 0 && p < parts) return from + (int)(items * team->begin[p] >> 16);
        return from + (int)(items * p / parts);
    }
    Share(const Team* team, int begin, int items, int of_first_kind, int p, int parts) {
        if (items == parts) {  // one each, whose number tells what it is
            first[0] = begin + p;
            last[0] = first[1] = last[1] = begin + p + 1;
            return;
        }
        const int of[] = {of_first_kind < items ? of_first_kind : items, items};
        for (int i = 0, from = 0; i < 2; from = of[i++]) {
            first[i] = Share::begin(team, begin + from, begin + of[i], p, parts);
            last[i] = Share::begin(team, begin + from, begin + of[i], p + 1, parts);
        }
    }
};
struct Phases {
    int count = 0;
    int first[MOST_PHASES + 1];        // item of each phase, and behind the last
    int parts[MOST_PHASES + 1] = {0};  // of all phases before each, and of all
    int split[MOST_PHASES];            // of each phase: items of the first kind, shared apart from the others

    // One more phase, up to an item; in parts of not less than so many. No phase where there are no items.
    void add(int end, int size, int least, int of_first_kind = 0) {
        const int items = end - first[count], most = items / least;
        if (items <= 0) return;
        parts[count + 1] = parts[count] + (most < 1 ? 1 : most < size ? most : size);
        split[count] = of_first_kind;
        first[++count] = end;
    }
};
// Take all phases: `part` is called with first and last item of each part; the largest number that it gave, or 0.
auto take_phases = [](Team* team, const Phases& phases, auto part) -> double {
    typedef decltype(part) Part;
    auto call = [](const void* given, int first, int last) -> double { return (*(const Part*)given)(first, last); };
    return team->take(team, &phases, call, &part);
};
// Whether a job would find anybody: not where there is no team, nobody has come, or who came was missed lately.
auto is_helped = [](Team* team) -> bool { return team && team->is_there(team); };
#endif
