"""Several places that supply one another: a line, or one warehouse with several stores."""
