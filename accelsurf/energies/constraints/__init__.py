"""Energies whose surface may not go everywhere: beyond a mask, or into another object."""
