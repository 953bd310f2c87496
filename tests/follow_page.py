"""Runs the Python examples of a page, each in a process and a folder away from the clone.

python tests/follow_page.py docs/quickstart.md build/bare/run
"""

import re
import subprocess
import sys
from pathlib import Path


def main(page, folder):
    """Run them in order; returns the exit status of the first that fails."""
    text = Path(page).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    Path(folder).mkdir(parents=True, exist_ok=True)
    for number, block in enumerate(blocks, 1):
        print(f"{page}: example {number} of {len(blocks)}", flush=True)
        result = subprocess.run([sys.executable, "-c", block], cwd=folder, check=False)
        if result.returncode:
            return result.returncode
    return 0 if blocks else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
