"""Parts of the study."""
