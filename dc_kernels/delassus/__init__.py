"""Contact problems u = W r + q and their solvers."""
