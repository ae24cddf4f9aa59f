"""The line protocol between the driver and a robot with two driven wheels, over a serial line."""
