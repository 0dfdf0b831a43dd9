/* What the arm follows where no joint velocity in the box meets the references. */
#ifndef MOC_FALLBACK_H
#define MOC_FALLBACK_H

/* The x (n,) in the box with the least |A x - b| [rad/s], by coordinate descent; zero where the record holds numbers
 * that are none. See least_violation in control/null_space.py. */
void moc_least_violation(const double *record, double *x);

#endif
