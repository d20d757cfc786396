"""Which stem explains PV: every path of the one-parameter valve, the two-parameter ones, and the models compared."""
