"""Networks in the place of the contact solver: from the state at t and its contacts to the velocities at t + dt."""
