"""Every setting of a run, stated once: its unit, bounds, default, help, and what it acts on."""
