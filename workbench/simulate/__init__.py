"""The exact hybrid simulation: one kernel, its coefficients, single runs and batches."""
