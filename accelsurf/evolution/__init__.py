"""The evolution of a surface: the loop of steps, their records, convergence, the energy budget, levels, checkpoints."""
