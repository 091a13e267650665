"""Files of a tracking: tables, frames, surfaces, pictures."""
