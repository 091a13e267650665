"""Images larger than memory with a truth by formula: a tree of vessels and a thousand cells, made chunk by chunk."""
