"""ContactNet: a network that corrects solves in flight."""
