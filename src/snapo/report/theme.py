"""The colours of a report, by meaning, for light and for dark paper.

Hues follow the palette of Okabe and Ito (2008), which stays apart under colour-blind vision; no
chart relies on colour alone. A chart is drawn in the light colours, and each is then replaced by
a CSS variable of its name, so that one drawing serves light, dark and print.
"""

LIGHT = {
    "ink": "#17212b",
    "muted": "#55616e",
    "rule": "#dde3e9",
    "paper": "#fefefe",
    "panel": "#f5f7f9",
    "main": "#1d3f72",
    "main-soft": "#c6d5ea",
    "inject": "#0072b2",
    "inject-soft": "#b8d9ec",
    "withdraw": "#d55e00",
    "withdraw-soft": "#f5cfb1",
    "other": "#7a8692",
    "reach": "#eaeef2",
    "limit": "#8d2f6b",
    "good": "#00704e",
    "bad": "#b3261e",
}
DARK = {
    "ink": "#e8edf2",
    "muted": "#a3afbb",
    "rule": "#323d49",
    "paper": "#12181f",
    "panel": "#1a222b",
    "main": "#8fb4ec",
    "main-soft": "#2b4163",
    "inject": "#56b4e9",
    "inject-soft": "#1f4459",
    "withdraw": "#f0883e",
    "withdraw-soft": "#5a3315",
    "other": "#8996a3",
    "reach": "#202a34",
    "limit": "#d889b9",
    "good": "#4cc49a",
    "bad": "#ff8a80",
}


def variables(colours: dict[str, str]) -> str:
    """CSS custom properties, `--ink: #17212b; …`."""
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


def by_variable(svg: str) -> str:
    """The same drawing with every colour of the light theme as `var(--name)`."""
    for name, colour in LIGHT.items():
        svg = svg.replace(colour, f"var(--{name})")
    return svg
