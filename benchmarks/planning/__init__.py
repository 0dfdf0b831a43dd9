"""What `benchmarks.plan` computes (`parts`) and how it is shown (`tables`)."""
