"""Every setting of a run, stated once: its unit, bounds, default, help, and scope."""
