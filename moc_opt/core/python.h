/* The binding's one way to take arguments: a table says what each of them has to be.
 *
 * Arrays come by the buffer protocol. All arguments are checked before anything is written: float64, C-contiguous, the
 * shape; a wrong one is a ValueError or TypeError that names the argument and the shape that it should have. */
#ifndef MOC_PYTHON_H
#define MOC_PYTHON_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "moc.h"
#include "tools.h"

/* An array that is read, written, written with any strides, or read and perhaps None; a number: double, int, or long
 * long and perhaps None, which is 0; or an object that the caller looks at. */
typedef enum { READ, WRITE, STRIDED, MAYBE, NUMBER, WHOLE, LONG, OBJECT } kind;

/* Lengths that are no plain number: n joints, k rows (the first such array says how many), any number,
 * a packed subproblem (11 n + 10), a packed state (n n + 13 n + 18), 2 n, a tick's results (14 n + 16).
 * Columns 0: an array of one axis. */
enum { N = -1, K = -2, ANY = -3, ROW = -4, TERMS = -5, TWICE = -6, TICKED = -7 };

typedef struct {
    const char *name;
    kind kind;
    int rows, columns;
} parameter;

enum { MOST_ARGUMENTS = 14 };

/* The arguments of one call, by their places in its table. */
typedef struct {
    int n;                         /* joints; 0 until an array tells */
    Py_ssize_t k;                  /* rows; -1 until an array tells */
    double *array[MOST_ARGUMENTS]; /* NULL for None */
    double number[MOST_ARGUMENTS];
    long long whole[MOST_ARGUMENTS];
    Py_buffer view[MOST_ARGUMENTS];
    int held; /* views that have to be released */
    int place[MOST_ARGUMENTS]; /* of an argument's view */
} call;

/* Take the arguments of a call on n joints (0: an array tells). Returns 0 with an exception, and nothing is held then. */
int moc_take(call *c, int n, const char *name, PyObject *const *args, Py_ssize_t count, const parameter *table, int wanted);

#define TAKE(c, n, name, ...)                                                                                          \
    moc_take(c, n, name, args, count, (const parameter[]){__VA_ARGS__},                                                \
             (int)(sizeof((const parameter[]){__VA_ARGS__}) / sizeof(parameter)))

/* Release the arrays of a call; returns the result. */
PyObject *moc_done(call *c, PyObject *result);

static inline PyObject *none(call *c)
{
    return moc_done(c, Py_NewRef(Py_None));
}

static inline PyObject *whole(call *c, int value)
{
    return moc_done(c, PyLong_FromLong(value));
}

/* Rows of argument i. */
static inline int rows_of(const call *c, int i)
{
    return (int)c->view[c->place[i]].shape[0];
}

/* --- structs --- */

/* A field of a struct: double, int, two doubles, one double a joint, rows of them (as many as the int `rows` says). */
typedef struct {
    const char *name;
    size_t offset;
    enum { DOUBLE, INT, PAIR, JOINTS, BASIS } kind;
    size_t rows;
} field;

#define FIELD(type, name, kind) {#name, offsetof(type, name), kind, 0}
#define COUNT(table) (sizeof(table) / sizeof(table)[0])

/* Fill a struct with the keywords of its fields' names, each of which has to be there. Returns 0 with an exception. */
int moc_fill(PyObject *keywords, const field *fields, size_t count, int n, void *to);

/* A field of a struct as a number, or as tuples of numbers. */
PyObject *moc_show(const field *f, int n, const void *from);

/* --- objects --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
} Arm;

extern PyTypeObject *moc_arm_type; /* set once, when the module is made */

void *moc_make(PyTypeObject *type);
const moc_arm *moc_arm_of(PyObject *given);

#define FAST(name, function, doc) {name, (PyCFunction)(void (*)(void))function, METH_FASTCALL, doc}

/* n of the subproblem is that of its record; see moc_opt/qp/layout.py and moc_opt/robots/state.py. */
void moc_unpack_problem(double *record, int n, moc_problem *problem);
void moc_pack_problem(moc_problem *problem, const double *q, double *record);
void moc_unpack_terms(double *record, int n, moc_terms *terms);
void moc_pack_terms(moc_terms *terms, int n, double *record);

extern PyMethodDef moc_functions[];

#endif
