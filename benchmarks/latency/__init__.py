"""What `benchmarks.speed` (runs, bare, verdict, page) and `benchmarks.realtime` (wire, clock) are made of."""
