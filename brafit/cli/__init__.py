"""The commands, a module each: brafit (`fit`), brafit-inspect, -mark, -collect, -sizes and -nest."""
