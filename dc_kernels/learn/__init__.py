"""A solve in flight as a network reads it, and differentiable sweeps."""
