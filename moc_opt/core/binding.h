/* What both halves of the binding share: arrays by the buffer protocol, each checked before anything is written. */
#ifndef MOC_BINDING_H
#define MOC_BINDING_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "moc.h"

#define MOST_ARRAYS 12

/* The arrays of one call; released together. */
typedef struct {
    Py_buffer view[MOST_ARRAYS];
    int count;
} arrays;

static inline PyObject *release(arrays *held, PyObject *result)
{
    for (int i = 0; i < held->count; i++)
        PyBuffer_Release(&held->view[i]);
    held->count = 0;
    return result;
}

enum { READ = 0, WRITE = 1, ANY = -1 };

static inline void refuse(const char *name, Py_ssize_t rows, Py_ssize_t columns, int written)
{
    const char *kind = written ? "a writable, C-contiguous array of float64" : "a C-contiguous array of float64";
    if (columns == 0)
        PyErr_Format(PyExc_ValueError, rows == ANY ? "%s: give %s with one axis" : "%s: give %s of shape (%zd,)", name,
                     kind, rows);
    else if (rows == ANY)
        PyErr_Format(PyExc_ValueError, "%s: give %s of shape (k, %zd)", name, kind, columns);
    else
        PyErr_Format(PyExc_ValueError, "%s: give %s of shape (%zd, %zd)", name, kind, rows, columns);
}

/* An array of shape (rows,) where columns is 0, else (rows, columns); rows = ANY: any number. NULL with an exception. */
static inline double *take(arrays *held, PyObject *given, const char *name, int written, Py_ssize_t rows, Py_ssize_t columns)
{
    Py_buffer *view = &held->view[held->count];
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (written ? PyBUF_WRITABLE : 0);

    if (PyObject_GetBuffer(given, view, flags) < 0) {
        PyErr_Clear();
        refuse(name, rows, columns, written);
        return NULL;
    }
    held->count++;
    if (view->format == NULL || strcmp(view->format, "d") != 0 || view->ndim != (columns ? 2 : 1) ||
        (rows != ANY && view->shape[0] != rows) || (columns && view->shape[1] != columns)) {
        refuse(name, rows, columns, written);
        return NULL;
    }
    return view->buf;
}

static inline Py_ssize_t rows_of(const arrays *held)
{
    return held->view[held->count - 1].shape[0];
}

static inline int count_is(Py_ssize_t given, Py_ssize_t wanted, const char *call)
{
    if (given == wanted)
        return 1;
    PyErr_Format(PyExc_TypeError, "%s takes %zd arguments, %zd were given", call, wanted, given);
    return 0;
}

/* --- the subproblem --- */

/* n of a packed subproblem of 10 n + 10 numbers; 0 with an exception. */
static inline int joints_of(Py_ssize_t length)
{
    if (length % 10 == 0 && length >= 20 && length / 10 - 1 <= MOC_MAX_JOINTS)
        return (int)(length / 10 - 1);
    PyErr_Format(PyExc_ValueError, "a subproblem of %zd numbers: give 10 n + 10 for n joints, n from 1 to %d", length,
                 MOC_MAX_JOINTS);
    return 0;
}

/* A (6,n), b (6,), grad_mu, lower, upper (n,), c0, c1, c2, rho, q (n,); see moc_opt/qp/layout.py. */
static inline void unpack(const double *record, int n, moc_problem *p)
{
    p->n = n;
    for (int i = 0; i < 6; i++, record += n)
        memcpy(p->A[i], record, (size_t)n * sizeof *record);
    memcpy(p->b, record, sizeof p->b);
    record += 6;
    memcpy(p->grad_mu, record, (size_t)n * sizeof *record);
    memcpy(p->lower, record + n, (size_t)n * sizeof *record);
    memcpy(p->upper, record + 2 * n, (size_t)n * sizeof *record);
    record += 3 * n;
    p->c0 = record[0];
    p->c1 = record[1];
    p->c2 = record[2];
    p->rho = record[3];
}

typedef struct {
    PyObject_HEAD
    moc_arm arm;
} Arm;

extern PyTypeObject *moc_arm_type;

/* Add what tools.c has to the module; -1 with an exception. */
int moc_add_tools(PyObject *module);

static inline const moc_arm *arm_of(PyObject *given)
{
    if (Py_TYPE(given) == moc_arm_type)
        return &((Arm *)given)->arm;
    PyErr_SetString(PyExc_TypeError, "arm: give a moc_opt.core.Arm");
    return NULL;
}

#define FAST(name, function, doc) {name, (PyCFunction)(void (*)(void))function, METH_FASTCALL, doc}

#endif
