"""Models from and to other formats, one module for each."""
