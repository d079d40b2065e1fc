"""Questions about where shapes are: what a ray or a moving shape meets, what overlaps, what is closest."""
