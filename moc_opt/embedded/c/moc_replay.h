/* Readings that came before, to the last bit: a recording played once more, or an encoder that lags. See control/replay_kernels.py. */
#ifndef MOC_REPLAY_H
#define MOC_REPLAY_H

#include "moc_constants.h"

#define MOC_REPLAY_SLOTS 4096 /* readings that are remembered, one a slot */
#define MOC_JOINT_SLOTS 256   /* the same of each encoder */

typedef struct {
    double readings; /* so far */
    double lag;      /* of the last one that came before, in readings */
    double hits;     /* how many came with that lag */
} moc_came_before;

typedef struct {
    double number[MOC_REPLAY_SLOTS]; /* a weighted sum of the reading, which equal readings share to the last bit */
    double at[MOC_REPLAY_SLOTS];     /* its place in the order of readings, from 1 on; 0: none */
    moc_came_before whole;
    double joint_number[MOC_N][MOC_JOINT_SLOTS], joint_at[MOC_N][MOC_JOINT_SLOTS]; /* the same of each encoder */
    moc_came_before joint[MOC_N];
} moc_replay_state;

/* Forget all readings. */
void moc_replay_start(moc_replay_state *state);

/* Take in a reading q, v (n,), wrench (6,); return how many came before, all of them by the same number of readings. */
double moc_replay_count(const double *q, const double *v, const double *wrench, moc_replay_state *state);

/* Take in a reading q, v (n,); return how many of one encoder came before, of the one with the most. */
double moc_replay_lagging(const double *q, const double *v, moc_replay_state *state);

#endif
