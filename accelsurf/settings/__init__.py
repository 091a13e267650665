"""Every setting of a run, said once: its unit, bounds, default, help, and what it acts on."""
