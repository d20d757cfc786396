"""Many loops: a whole site screened, ranked and told in one report, on one machine or a Dask cluster."""
