"""Links of a page to files outside of docs/, such as examples: on a code host they open the file.

On the site a file is downloaded; a folder and a page, such as CHANGELOG.md, are only named.
"""

import re
from pathlib import Path

LINK = re.compile(r"\[([^\]]+)\]\((\.\.?/[^)#\s]+)\)")


def setup(app):
    """Looks through every page before it is parsed."""
    app.connect("source-read", _settled)
    return {"parallel_read_safe": True}


def _settled(app, name, source):
    folder = Path(app.env.doc2path(name)).parent
    docs = Path(app.srcdir).resolve()

    def shown(match: re.Match) -> str:
        target = (folder / match[2]).resolve()
        if target.is_relative_to(docs) or (target.is_file() and target.suffix != ".md"):
            return match[0]
        return f"`{match[1].strip('`')}`"

    source[0] = LINK.sub(shown, source[0])
