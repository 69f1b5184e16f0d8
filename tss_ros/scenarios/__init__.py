"""Systems as YAML files."""
