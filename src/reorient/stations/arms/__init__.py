"""Drivers of robot arms, one file per vendor, on a common supervision of each move."""
