"""The commands: brafit, brafit-inspect, brafit-mark, brafit-collect."""
