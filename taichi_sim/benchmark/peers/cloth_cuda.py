"""The cloth step as a CUDA kernel written by hand, compiled by CuPy: the loop of cloth_openmp.c, one thread a ball."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Cloth, HalfSprings
from taichi_sim.benchmark.peers import PeerMissingError

try:
    import cupy
except ImportError:
    raise PeerMissingError("CuPy is not installed (pip install cupy-cuda12x)") from None

# Velocities change in place, as only their own thread reads them; positions go from one array to another. Masses are 1 kg.
SOURCE = r"""
extern "C" __global__ void cloth_step(int n, const int *__restrict__ start, const int *__restrict__ neighbour,
                                      const float *__restrict__ stiffness, const float *__restrict__ rest_length,
                                      const float3 *__restrict__ now, float3 *__restrict__ velocity,
                                      float3 *__restrict__ next, float h, float gx, float gy, float gz)
{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= n)
        return;
    const float3 x = now[i];
    float3 a = make_float3(gx, gy, gz);
    for (int s = start[i]; s < start[i + 1]; s++) {
        const float3 other = now[neighbour[s]];
        const float rx = other.x - x.x, ry = other.y - x.y, rz = other.z - x.z;
        const float inverse = rsqrtf(fmaxf(rx * rx + ry * ry + rz * rz, 1e-30f));
        const float f = stiffness[s] * (1.0f - rest_length[s] * inverse); /* k (d - l) / d */
        a.x += f * rx;
        a.y += f * ry;
        a.z += f * rz;
    }
    float3 v = velocity[i];
    v.x += h * a.x;
    v.y += h * a.y;
    v.z += h * a.z;
    velocity[i] = v;
    next[i] = make_float3(x.x + h * v.x, x.y + h * v.y, x.z + h * v.z);
}
"""
THREADS = 256  # of a block


class ClothCuda:
    """A cloth stepped by the kernel above in f32, on the first CUDA device."""

    def __init__(self, cloth: Cloth, half: HalfSprings) -> None:
        try:
            cupy.cuda.runtime.getDeviceCount()
            self._kernel = cupy.RawKernel(SOURCE, "cloth_step")
            self._kernel.compile()
        except (cupy.cuda.runtime.CUDARuntimeError, cupy.cuda.compiler.CompileException, ImportError) as error:
            raise PeerMissingError(f"CuPy cannot run here: {str(error).strip().splitlines()[0]}") from None
        self._numbers = tuple(map(np.float32, (cloth.dt, *cloth.gravity)))
        self._springs = [cupy.asarray(column) for column in half]
        self._first = [cupy.asarray(values, dtype=cupy.float32) for values in (cloth.position, cloth.velocity)]
        self._x, self._v = (values.copy() for values in self._first)
        self._next = cupy.empty_like(self._x)

    def reset(self) -> None:
        self._x[:], self._v[:] = self._first

    def step(self, steps: int) -> None:
        n = len(self._x)
        for _ in range(steps):
            arguments = (np.int32(n), *self._springs, self._x, self._v, self._next, *self._numbers)
            self._kernel((-(-n // THREADS),), (THREADS,), arguments)
            self._x, self._next = self._next, self._x
        cupy.cuda.get_current_stream().synchronize()

    def result(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return cupy.asnumpy(self._x), cupy.asnumpy(self._v)
