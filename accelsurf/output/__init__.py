"""Files of a run: report, tables, names, folders."""
