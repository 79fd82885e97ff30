"""Names of inputs in words."""


def name_of(name: str, label: str = "") -> str:
    """An input in words: "Zero rate, 10y"."""
    words = name.replace("plan_", "").replace("_", " ").replace("lee carter", "Lee-Carter")
    words = words[:1].upper() + words[1:]
    return f"{words}, {label}" if label else words
