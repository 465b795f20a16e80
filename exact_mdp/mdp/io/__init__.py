"""Reading and writing models, one module for each format."""
