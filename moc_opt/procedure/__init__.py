"""What comes before and around a run: reachability, pre-flight, hands-on."""
