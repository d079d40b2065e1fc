"""What a program that drives a simulation asks of it: copies, resets, changes of the model, events, forces."""
