"""Underwires that can be bought: their sizes as arcs."""
