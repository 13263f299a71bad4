"""The settings of brafit, as YAML groups. Installed as the package `brafit.conf`."""
