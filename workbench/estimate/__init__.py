"""From a record to plant, valve, stem position, uncertainty and verdict."""
