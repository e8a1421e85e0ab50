"""Pictures of the site's pages in headless Chromium, at desktop and phone width, light and dark: out/pages/."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
WIDTHS = {"desktop": "1280,1600", "phone": "500,1600"}  # Chromium's window has no less than 500 pixels


def picture(page: str, width: str, dark: bool) -> Path:
    """Path of the picture of one page."""
    out = ROOT / "out" / "pages" / f"{page.replace('/', '_')}_{width}{'_dark' if dark else ''}.png"
    out.parent.mkdir(parents=True, exist_ok=True)
    command = ["chromium", "--headless=new", "--no-sandbox", "--hide-scrollbars", f"--window-size={WIDTHS[width]}"]
    command += ["--blink-settings=preferredColorScheme=0"] * dark + [f"--screenshot={out}"]
    address = (ROOT / "out" / "docs" / f"{page}.html").as_uri()
    subprocess.run([*command, address], check=True, capture_output=True, timeout=60)
    return out


if __name__ == "__main__":
    for page in sys.argv[1:]:
        for width in WIDTHS:
            for dark in (False, True):
                print(picture(page, width, dark))
