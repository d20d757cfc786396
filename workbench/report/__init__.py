"""What has been found, told: figures, tables, words, and the HTML page. No computing."""
