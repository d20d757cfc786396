"""The interactive workbench in a browser: a Bokeh server on this machine, its page, and what stands behind it."""
