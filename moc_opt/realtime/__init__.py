"""The closed loop over UDP: the plant keeps the time in one process, the controller answers in another."""
