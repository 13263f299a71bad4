"""The settings of the command: their types and limits, how they are composed, and what is said of wrong ones."""
