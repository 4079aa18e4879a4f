"""Documents that the program reads and writes: YAML and JSON, through one loader with limits and a schema each."""
