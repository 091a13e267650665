"""Hand-written vector code."""
