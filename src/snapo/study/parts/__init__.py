"""Parts that every study with a trained policy can have; `snapo.report.sections` tell them."""
