"""What a run leaves behind: its columns, its file, its ending, its metrics."""
