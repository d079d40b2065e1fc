// The velocities that solve/bodies.h and side.h take are those before the impulses of the step. Parameters: motion.
const auto& bodies = motion.predicted;
