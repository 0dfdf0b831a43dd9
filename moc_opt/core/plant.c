/* What the simulated plant needs between two of MuJoCo's steps; no part of the exported controller. */
#include <string.h>

#include "tools.h"
#include "vec.h"

void plant_shaft_force(const double *tip, const double *wrist, const double twist[6], const double *origin,
                       const double trocar[6], double elapsed, double stiffness, double damping, double force[3],
                       double point[3])
{
    double u[3], P[3], lever[3], w[3], length;

    for (int i = 0; i < 3; i++)
        u[i] = tip[i] - wrist[i];
    length = sqrt(dot3(u, u));
    for (int i = 0; i < 3; i++) {
        u[i] /= length;
        P[i] = trocar[i] + elapsed * trocar[3 + i];
    }
    double along = dot3(P, u) - dot3(tip, u);
    for (int i = 0; i < 3; i++) {
        point[i] = tip[i] + along * u[i];
        lever[i] = point[i] - origin[i];
        w[i] = twist[3 + i];
    }
    add_cross(1.0, twist, lever, w);
    for (int i = 0; i < 3; i++)
        force[i] = stiffness * (P[i] - point[i]) + damping * (trocar[3 + i] - w[i]);
    double axial = dot3(force, u);
    for (int i = 0; i < 3; i++)
        force[i] -= axial * u[i];
}

void plant_add_force(double wrench[6], const double force[3], const double point[3], const double com[3])
{
    double lever[3];
    for (int i = 0; i < 3; i++) {
        lever[i] = point[i] - com[i];
        wrench[i] += force[i];
    }
    add_cross(1.0, lever, force, wrench + 3);
}

void plant_read_encoders(const plant_encoders *e, int n, const double *q, const double *v, const double *noise,
                         double *memory, double *reading)
{
    const double *bias = memory;
    double *last = memory + n, *speed = memory + 2 * n;

    for (int i = 0; i < n; i++) {
        reading[i] = q[i] + bias[i];
        reading[n + i] = v[i];
        if (e->exact)
            continue;
        double position = reading[i] + noise[i];
        if (e->resolution > 0.0)
            position = e->resolution * nearbyint(position / e->resolution);
        speed[i] += e->gain * ((position - last[i]) / e->period - speed[i]);
        reading[i] = last[i] = position;
        reading[n + i] = speed[i];
    }
}
