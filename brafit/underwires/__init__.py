"""Underwires that can be bought: the charts of their makers, their shapes, and the one nearest to a wire line."""
