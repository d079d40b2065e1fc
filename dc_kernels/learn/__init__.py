"""Features of paused solves for networks, corrections of their impulses, and differentiable sweeps."""
