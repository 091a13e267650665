"""One run: its image is prepared, its energy made, its objects evolved; it leaves a Result."""
