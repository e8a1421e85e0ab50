"""SwiftShader, Vulkan in software: slow, but right, so that the tests of devices run on a machine without a GPU."""

import json
import os
import shutil
import tempfile
from pathlib import Path

import pytest

from taichi_sim.device.devices import find

PLACES = (  # where packages of Chromium put it
    "/usr/lib/chromium/libvk_swiftshader.so",
    "/usr/lib/chromium-browser/libvk_swiftshader.so",
    "/usr/lib64/chromium-browser/libvk_swiftshader.so",
    "/opt/google/chrome/libvk_swiftshader.so",
)


def offer_software(config):
    """Where there is no GPU with a driver, and the user has named none, let the Vulkan loader find SwiftShader."""
    device = find("vulkan")
    if device is not None and (not device.software or "VK_ICD_FILENAMES" in os.environ):
        return
    library = next((place for place in PLACES if Path(place).is_file()), None)
    if library is None:
        raise pytest.UsageError(
            "--arch vulkan: there is no Vulkan device here; install a GPU's driver, or SwiftShader, which is part of Chromium:"
            " apt-get install chromium libvulkan1"
        )
    description = {"library_path": library, "api_version": "1.3.0"}
    folder = tempfile.mkdtemp(prefix="swiftshader-")
    config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
    file = Path(folder) / "icd.json"
    file.write_text(json.dumps({"file_format_version": "1.0.0", "ICD": description}))
    os.environ["VK_ICD_FILENAMES"] = str(file)
    if find("vulkan") is None:
        raise pytest.UsageError(f"--arch vulkan: {library} is there, but no Vulkan loader: apt-get install libvulkan1")
