"""The course: pages and pictures, which `taichi-sim course` opens."""
