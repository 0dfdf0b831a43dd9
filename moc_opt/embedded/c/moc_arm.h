/* What the guard knows of the arm: generated equations. */
#ifndef MOC_ARM_H
#define MOC_ARM_H

#include "moc_constants.h"

/* The torque g (n,) [Nm] that carries the arm's weight at q (n,) [rad]. */
void moc_gravity(const double *q, double *g);

/* The tool's axes x, y, z (along the shaft) and its tip [m], (4,3) in world axes. */
void moc_tool_pose(const double *q, double *pose);

#endif
