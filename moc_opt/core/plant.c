/* The simulated trocar (for sim/plant.py) and encoders (for sim/sensors.py). */
#include "python.h"
#include "vec.h"

/* Compute the trocar's force on the tool and its moment about the tool's centre of mass com, in world axes.
 * force = (I - u u^T)(stiffness (P - p) + damping (dP - w)). P is the trocar, u the shaft's direction, p the shaft's
 * point nearest to P, and w the tool's velocity at p. twist: the tool's angular velocity, and the velocity
 * of its point `origin`. trocar: P `elapsed` seconds ago, and the constant dP. */
FUNCTION(shaft_wrench, {"tip", READ, 3}, {"wrist", READ, 3}, {"twist", READ, 6}, {"origin", READ, 3}, {"com", READ, 3},
         {"trocar", READ, 2, 3}, {"elapsed", NUMBER}, {"stiffness", NUMBER}, {"damping", NUMBER}, {"wrench", WRITE, 6})
{
    const double *tip = c->array[0], *wrist = c->array[1], *twist = c->array[2], *origin = c->array[3];
    const double *com = c->array[4], *P_start = c->array[5], *dP = c->array[5] + 3;
    double *force = c->array[9], *moment = c->array[9] + 3;
    double u[3], P[3], point[3], lever[3], w[3];

    for (int i = 0; i < 3; i++) {
        u[i] = tip[i] - wrist[i];
        P[i] = P_start[i] + c->number[6] * dP[i];
    }
    normalise3(u);
    double along = dot3(P, u) - dot3(tip, u);
    for (int i = 0; i < 3; i++) {
        point[i] = tip[i] + along * u[i];
        lever[i] = point[i] - origin[i];
        w[i] = twist[3 + i];
    }
    add_cross(1.0, twist, lever, w);
    for (int i = 0; i < 3; i++)
        force[i] = c->number[7] * (P[i] - point[i]) + c->number[8] * (dP[i] - w[i]);
    double axial = dot3(force, u);
    for (int i = 0; i < 3; i++) {
        force[i] -= axial * u[i];
        lever[i] = point[i] - com[i];
        moment[i] = 0.0;
    }
    add_cross(1.0, lever, force, moment);
    Py_RETURN_NONE;
}

/* Compute encoder readings: positions, then low-pass filtered velocities. Rows of memory: bias, previous position,
 * filtered velocity. resolution: step of the encoder [rad]. gain: weight of a new value in the filter. With exact = 1,
 * the readings are q + bias and v. */
FUNCTION(read_encoders, {"q", READ, N}, {"v", READ, N}, {"noise", READ, N}, {"memory", WRITE, 3, N},
         {"resolution", NUMBER}, {"period", NUMBER}, {"gain", NUMBER}, {"exact", WHOLE}, {"reading", WRITE, 2, N})
{
    const double *bias = c->array[3], resolution = c->number[4];
    double *last = c->array[3] + c->n, *speed = last + c->n, *reading = c->array[8];

    for (int i = 0; i < c->n; i++) {
        reading[i] = c->array[0][i] + bias[i];
        reading[c->n + i] = c->array[1][i];
        if (whole(c, 7))
            continue;
        double position = reading[i] + c->array[2][i];
        if (resolution > 0.0)
            position = resolution * nearbyint(position / resolution);
        speed[i] += c->number[6] * ((position - last[i]) / c->number[5] - speed[i]);
        reading[i] = last[i] = position;
        reading[c->n + i] = speed[i];
    }
    Py_RETURN_NONE;
}

PyMethodDef moc_plant_functions[] = {
    ENTRY(core, shaft_wrench), ENTRY(core, read_encoders), {NULL, NULL, 0, NULL},
};
