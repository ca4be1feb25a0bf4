"""Drivers of depth cameras, one file per vendor."""
