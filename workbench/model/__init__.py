"""What a loop is: frozen, validated values and results. No computing, no import of another part of Workbench."""
