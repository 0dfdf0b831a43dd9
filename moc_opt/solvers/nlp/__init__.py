"""The nonlinear program of the same tick."""
