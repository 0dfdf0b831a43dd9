"""What `python -m benchmarks.plant` is made of: its runs (`runs`), and its tables and page (`tables`)."""
