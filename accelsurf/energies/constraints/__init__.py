"""Energies held back in places: by a mask, or by the contact with other objects."""
