"""Time and error of the simulator."""
