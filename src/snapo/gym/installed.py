"""Gymnasium, or one sentence that says how to get it."""

try:
    import gymnasium
except ImportError as error:
    raise ImportError(
        "snapo.gym needs Gymnasium, which is not installed: pip install 'snapo[gym]'."
    ) from error

__all__ = ["gymnasium"]
