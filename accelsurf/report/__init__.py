"""What a run leaves behind besides labels and meshes: the JSON report, tables, pictures."""
