"""From a record to plant, valve, stem position, uncertainty and verdict.

`estimate` asks each plant for its `answer`, which holds all `record_fits` and comes to one `verdict`. What these stand
on lies in folders, each of which knows only those before it: `kernels` (compiled loops), `fits` (a plant along a given
stem), `search` (which stem), `loads` (what else moves PV), `ranges` (what is left open) and `methods` (beside the
profile).
"""
