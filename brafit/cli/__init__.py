"""The commands: brafit, brafit-inspect, brafit-collect."""
