/* One symplectic Euler step of a cloth in f32: each ball gathers the forces of its own springs, then moves.
 *
 * The plain loop that the program's springs are measured against: no atomics, no scratch memory, position and velocity side
 * by side, two copies of the state that swap roles. Masses are 1 kg; a spring whose ends coincide pulls nowhere.
 */
#include <math.h>

typedef struct {
    float x[3], v[3];
} ball;

typedef struct {
    int neighbour;
    float stiffness, rest_length;
} half_spring;

static void step(int n, const int *restrict start, const half_spring *restrict springs, const ball *restrict now,
                 ball *restrict next, float h, const float *restrict gravity, int threads)
{
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int i = 0; i < n; i++) {
        const float x = now[i].x[0], y = now[i].x[1], z = now[i].x[2];
        float ax = gravity[0], ay = gravity[1], az = gravity[2];
        for (int s = start[i]; s < start[i + 1]; s++) {
            const ball *other = &now[springs[s].neighbour];
            const float rx = other->x[0] - x, ry = other->x[1] - y, rz = other->x[2] - z;
            const float d2 = rx * rx + ry * ry + rz * rz;
            const float inverse = 1.0f / sqrtf(d2 > 1e-30f ? d2 : 1e-30f);
            const float f = springs[s].stiffness * (1.0f - springs[s].rest_length * inverse); /* k (d - l) / d */
            ax += f * rx;
            ay += f * ry;
            az += f * rz;
        }
        const float a[3] = {ax, ay, az};
        for (int c = 0; c < 3; c++) {
            next[i].v[c] = now[i].v[c] + h * a[c];
            next[i].x[c] = now[i].x[c] + h * next[i].v[c];
        }
    }
}

/* The state is in `even` before the first step; it ends in `even` after an even number of steps, else in `odd`. */
void cloth_steps(int n, const int *start, const half_spring *springs, ball *even, ball *odd, float h,
                 const float *gravity, int steps, int threads)
{
    for (int t = 0; t < steps; t++)
        step(n, start, springs, t % 2 ? odd : even, t % 2 ? even : odd, h, gravity, threads);
}
