"""What moves PV beside the valve: load steps, a coloured disturbance, a sinusoid; the models beside them."""
