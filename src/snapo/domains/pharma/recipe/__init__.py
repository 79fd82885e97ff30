"""The best recipe of the nominal model."""
