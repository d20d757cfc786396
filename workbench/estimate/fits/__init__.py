"""A record as the search takes it, and fits of a plant along a given stem: how good, and how sure."""
