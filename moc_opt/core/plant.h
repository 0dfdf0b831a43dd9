/* The simulated plant's tissue and encoders; sim/contact.py and sim/sensors.py say what they model. */
#ifndef MOC_PLANT_H
#define MOC_PLANT_H

/* Force of the trocar on the shaft and where it acts, world axes: with the shaft's point c nearest to the trocar P and
 * the velocity w of the tool's material there, force = (I - u u^T)(stiffness (P - c) + damping (dP - w)).
 * tip, wrist: two points of the shaft's line; twist: angular velocity, then the velocity at origin; trocar: P and dP at
 * the start of the period, `elapsed` seconds ago. */
void plant_shaft_force(const double *tip, const double *wrist, const double twist[6], const double *origin,
                       const double trocar[6], double elapsed, double stiffness, double damping, double force[3],
                       double point[3]);

/* Add a force at a point to a body's wrench (force, then moment about com), world axes. */
void plant_add_force(double wrench[6], const double force[3], const double point[3], const double com[3]);

typedef struct {
    double resolution, period, gain; /* [rad], [s], share of the difference quotient that the estimate takes up */
    int exact;                       /* 1: position and velocity are exact but for the bias */
} plant_encoders;

/* reading (2 n,): positions, then velocities. memory (3, n): bias, last position, estimate of the velocity. */
void plant_read_encoders(const plant_encoders *e, int n, const double *q, const double *v, const double *noise,
                         double *memory, double *reading);

#endif
