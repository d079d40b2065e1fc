"""From contacts to impulses: rows, sweeps, accelerations, integration."""
