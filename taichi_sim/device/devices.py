"""Devices that this machine has, by name, and which of them may be taken without being asked for."""

import ctypes
import ctypes.util
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from taichi_sim.common.memory import available
from taichi_sim.common.own_modules import OWN_MODULES
from taichi_sim.common.remembered import recall, remember

__all__ = ["Device", "find", "verdict"]

OTHER, INTEGRATED, DISCRETE, VIRTUAL, SOFTWARE = range(5)  # VkPhysicalDeviceType
PREFERENCE = (DISCRETE, INTEGRATED, VIRTUAL, OTHER, SOFTWARE)  # Taichi's
DEVICE_LOCAL = 1  # VK_MEMORY_HEAP_DEVICE_LOCAL_BIT
MOST_VULKAN_DEVICES = 16
WRONG = "wrong: "  # how the self-test begins to say what is
SELF_TEST, PATIENCE = "taichi_sim.reports.self_test", 120.0  # a program, and the s that it may take
START = OWN_MODULES + "from runpy import run_module; run_module(sys.argv.pop(1), run_name='__main__')"  # as `python -m`


class Device(NamedTuple):
    """Device of the machine: name and driver as the driver says them, memory in bytes, of the CPU what is free; "" and 0 where
    that is not known. software: the CPU computes in its place, right but slowly."""

    arch: str
    name: str
    driver: str = ""
    memory: int = 0
    software: bool = False

    @property
    def words(self) -> str:
        """Name and driver."""
        return f"{self.name} ({self.driver})" if self.driver else self.name


def find(arch: str) -> Device | None:
    """The device that "cpu", "cuda", "vulkan" or "metal" would run on; None where there is none."""
    if arch == "cpu":
        return Device(arch, platform.processor() or platform.machine(), "", available())
    if arch == "metal":
        return Device(arch, f"GPU of {platform.machine()}", platform.mac_ver()[0]) if sys.platform == "darwin" else None
    return _cuda() if arch == "cuda" else _vulkan()


def verdict(device: Device, version: str, again: bool = False) -> str:
    """Empty where the device has passed the self-test once with this driver and version of the engine, else what is wrong. The
    first call for a device runs it, which takes seconds, and remembers the result; so does one that asks for it again."""
    key = " | ".join((device.arch, device.name, device.driver, version))
    known = recall("devices")
    if again or not isinstance(known.get(key), str):
        known[key] = examine(device.arch)
        remember("devices", known)
    return known[key]


def examine(arch: str) -> str:
    """Fault of a device, or "" where it passed the self-test. It runs in a process of its own, which a broken driver may
    end."""
    try:
        command = [sys.executable, "-c", START, SELF_TEST, arch]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return f"the self-test did not end within {PATIENCE:g} s"
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return f"the self-test ended with status {done.returncode}: {last}"
    # the engine may say other things before
    return "".join(line.removeprefix(WRONG) for line in done.stdout.splitlines() if line.startswith(WRONG))


def _library(*names: str) -> Any:
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def _cuda() -> Device | None:
    """Its first device, by the CUDA driver API."""
    cuda = _library("libcuda.so.1", "nvcuda.dll")
    device, version, memory, name = ctypes.c_int(), ctypes.c_int(), ctypes.c_size_t(), ctypes.create_string_buffer(256)
    if cuda is None or cuda.cuInit(0) or cuda.cuDeviceGet(ctypes.byref(device), 0):
        return None
    cuda.cuDeviceGetName(name, len(name), device)
    cuda.cuDeviceTotalMem_v2(ctypes.byref(memory), device)
    cuda.cuDriverGetVersion(ctypes.byref(version))
    driver = f"CUDA {version.value // 1000}.{version.value % 1000 // 10}"
    return Device("cuda", name.value.decode(errors="replace"), driver, memory.value)


class _InstanceInfo(ctypes.Structure):
    """VkInstanceCreateInfo; ctypes leaves the gaps that C does."""

    _fields_ = (
        ("type", ctypes.c_uint32),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("layers", ctypes.c_uint32),
        ("layer_names", ctypes.c_void_p),
        ("extensions", ctypes.c_uint32),
        ("extension_names", ctypes.c_void_p),
    )


class _Heap(ctypes.Structure):
    """VkMemoryHeap."""

    _fields_ = (("size", ctypes.c_uint64), ("flags", ctypes.c_uint32))


class _Memory(ctypes.Structure):
    """VkPhysicalDeviceMemoryProperties."""

    _fields_ = (
        ("types", ctypes.c_uint32),
        ("type", ctypes.c_uint32 * 2 * 32),
        ("heaps", ctypes.c_uint32),
        ("heap", _Heap * 16),
    )


class _Properties(ctypes.Structure):
    """VkPhysicalDeviceProperties, of which the end is left as it comes."""

    _fields_ = (
        ("api", ctypes.c_uint32),
        ("driver", ctypes.c_uint32),
        ("vendor", ctypes.c_uint32),
        ("device", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
        ("name", ctypes.c_char * 256),
        ("rest", ctypes.c_uint8 * 2048),
    )


@contextmanager
def _vulkan_instance() -> Iterator[tuple[Any, ctypes.c_void_p] | None]:
    vulkan = _library("libvulkan.so.1", "vulkan-1.dll", ctypes.util.find_library("vulkan") or "libvulkan.1.dylib")
    instance = ctypes.c_void_p()
    if vulkan is None or vulkan.vkCreateInstance(ctypes.byref(_InstanceInfo(type=1)), None, ctypes.byref(instance)):
        yield None
        return
    try:
        yield vulkan, instance
    finally:
        vulkan.vkDestroyInstance(instance, None)


def _vulkan() -> Device | None:
    """The device that Taichi takes: the one that TI_VISIBLE_DEVICE numbers, else the best kind."""
    with _vulkan_instance() as found:
        if found is None:
            return None
        vulkan, instance = found
        count, handles = ctypes.c_uint32(MOST_VULKAN_DEVICES), (ctypes.c_void_p * MOST_VULKAN_DEVICES)()
        vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
        devices = [_described(vulkan, ctypes.c_void_p(handle)) for handle in handles[: count.value]]
    if not devices:
        return None
    chosen = os.environ.get("TI_VISIBLE_DEVICE", "")
    if chosen.isdigit() and int(chosen) < len(devices):
        return devices[int(chosen)][1]
    return min(devices, key=lambda pair: PREFERENCE.index(pair[0]))[1]


def _described(vulkan: Any, handle: ctypes.c_void_p) -> tuple[int, Device]:
    """Its kind, and what it is."""
    properties, memory = _Properties(), _Memory()
    vulkan.vkGetPhysicalDeviceProperties(handle, ctypes.byref(properties))
    vulkan.vkGetPhysicalDeviceMemoryProperties(handle, ctypes.byref(memory))
    heaps = [heap.size for heap in memory.heap[: memory.heaps] if heap.flags & DEVICE_LOCAL]
    kind = properties.kind if properties.kind in PREFERENCE else OTHER
    api = f"Vulkan {properties.api >> 22 & 0x7F}.{properties.api >> 12 & 0x3FF}, driver {properties.driver:#x}"
    name = properties.name.decode(errors="replace")
    return kind, Device("vulkan", name, api, max(heaps, default=0), kind == SOFTWARE)
