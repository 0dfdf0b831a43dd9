/* Copies between a struct, whose rows have MOC_MAX_JOINTS numbers, and its record, whose rows have n. */
#include <stddef.h>

#include "shared.h"

/* A part of a struct. N stands for n. */
typedef struct {
    size_t offset;
    int rows, columns;
} part;

enum { N = 0 };

#define PART(type, name, rows, columns) {offsetof(type, name), rows, columns}

static const part terms_parts[] = {
    PART(moc_terms, q, 2, N), PART(moc_terms, tip, 1, 9), PART(moc_terms, A, 6, N), PART(moc_terms, drift, 1, 6),
    PART(moc_terms, grad_mu, 2, N), PART(moc_terms, M, N, N), PART(moc_terms, h, 3, N), PART(moc_terms, mu, 1, 3),
};

static const part problem_parts[] = {
    PART(moc_problem, A, 6, N), PART(moc_problem, b, 1, 6), PART(moc_problem, grad_mu, 4, N),
    PART(moc_problem, c0, 1, 4),      PART(moc_problem, q, 1, N),
};

static void copy_parts(const part *parts, size_t count, int n, void *of, double *record, direction way)
{
    for (size_t k = 0; k < count; k++) {
        double *row = (double *)((char *)of + parts[k].offset);
        int rows = parts[k].rows == N ? n : parts[k].rows, columns = parts[k].columns == N ? n : parts[k].columns;
        for (int i = 0; i < rows; i++, row += MOC_MAX_JOINTS, record += columns) {
            double *to = way == PACK ? record : row;
            const double *from = way == PACK ? row : record;
            for (int j = 0; j < columns; j++)
                to[j] = from[j];
        }
    }
}

void moc_copy_problem(moc_problem *p, int n, double *record, direction way)
{
    p->n = n;
    copy_parts(problem_parts, sizeof problem_parts / sizeof *problem_parts, n, p, record, way);
}

void moc_copy_terms(moc_terms *t, int n, double *record, direction way)
{
    copy_parts(terms_parts, sizeof terms_parts / sizeof *terms_parts, n, t, record, way);
}
