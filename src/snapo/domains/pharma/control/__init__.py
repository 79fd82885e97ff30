"""The process in closed loop."""
