/* The Python binding. Each function has a table of its arguments, which are checked before anything is written. */
#ifndef MOC_PYTHON_H
#define MOC_PYTHON_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL moc_numpy
#ifndef MOC_MODULE /* python.c imports NumPy for all files */
#define NO_IMPORT_ARRAY
#endif
#include <Python.h>
#include <limits.h>
#include <math.h>
#include <numpy/arrayobject.h>
#include <stddef.h>
#include <string.h>

#include "tools.h"

/* READ: a C-contiguous float64 array. WRITE: such an array, to fill. STRIDED: an array with any strides, to fill.
 * MAYBE: READ or None. NUMBER: a float. WHOLE: an integer. MADE: an array that the call creates, at the table's end. */
typedef enum { READ, WRITE, STRIDED, MAYBE, NUMBER, WHOLE, MADE } kind;

/* Symbolic lengths (formulas: arguments.c). N is n joints, ROW the record of a subproblem, TERMS that of moc_terms, and
 * TICKED the results of a tick. The first array of length K sets k. ANY: any length. columns = 0: one axis. */
enum { N = -1, ROW = -2, TERMS = -3, TICKED = -4, K = -5, ANY = -6 };

typedef struct {
    const char *name;
    kind kind;
    int rows, columns;
} parameter;

enum { MOST_ARGUMENTS = 14 };

typedef struct {
    int n;                                /* joints; 0 until an array sets it */
    npy_intp k;                           /* length K; -1 until an array sets it */
    int made, end;                        /* argument i is an array of kind MADE if made <= i < end */
    double *array[MOST_ARGUMENTS];        /* NULL for None */
    double number[MOST_ARGUMENTS];
    PyArrayObject *as[MOST_ARGUMENTS];
} call;

/* Take the arguments. n = 0: the first array sets n. On failure, sets an exception and returns false. */
bool moc_take(call *c, int n, const char *name, PyObject *const *args, Py_ssize_t count, const parameter *table,
             int size);

/* Release the call's references to MADE arrays. Returns `result`. */
PyObject *moc_done(call *c, PyObject *result);

static inline int rows_of(const call *c, int i)
{
    return (int)PyArray_DIM(c->as[i], 0);
}

static inline int whole(const call *c, int i)
{
    return (int)fmin(fmax(c->number[i], INT_MIN), INT_MAX);
}

#define COUNT(table) ((int)(sizeof(table) / sizeof(table)[0]))

/* FUNCTION(name, parameters...) { body } defines a function, METHOD(Type, name, parameters...) { body } a method, with
 * the arguments in `c` and the object in `self`. _core.pyi describes each. */
#define CALL(function, name, joints, body, ...)                                                                        \
    static PyObject *function(PyObject *self, PyObject *const *args, Py_ssize_t count)                                 \
    {                                                                                                                  \
        static const parameter table[] = {__VA_ARGS__};                                                                \
        call c;                                                                                                        \
        (void)self;                                                                                                    \
        return moc_take(&c, joints, name, args, count, table, COUNT(table)) ? moc_done(&c, body) : NULL;               \
    }
#define FUNCTION(name, ...)                                                                                            \
    static PyObject *name##_body(const call *c);                                                                       \
    CALL(core_##name, #name, 0, name##_body(&c), __VA_ARGS__)                                                          \
    static PyObject *name##_body(const call *c)
#define METHOD(Type, name, ...)                                                                                        \
    static PyObject *Type##_##name##_body(Type *self, const call *c);                                                  \
    CALL(Type##_##name, #name, ((Arm *)self)->arm.n, Type##_##name##_body((Type *)self, &c), __VA_ARGS__)              \
    static PyObject *Type##_##name##_body(Type *self, const call *c)
#define ENTRY(Type, name) {#name, (PyCFunction)(void (*)(void))Type##_##name, METH_FASTCALL, NULL}

/* Every object of the module starts with its arm. */
typedef struct {
    PyObject_HEAD
    moc_arm arm;
} Arm;

#define TYPE(Type, new, ...)                                                                                           \
    static PyMethodDef Type##_methods[] = {__VA_ARGS__, {NULL, NULL, 0, NULL}};                                        \
    static PyType_Slot Type##_slots[] = {{Py_tp_new, new}, {Py_tp_methods, Type##_methods}, {0, NULL}};                \
    PyType_Spec moc_##Type = {"moc_opt.core._core." #Type, sizeof(Type), 0, Py_TPFLAGS_DEFAULT, Type##_slots}

extern PyType_Spec moc_Arm, moc_Law, moc_Guard;                       /* python_arm.c, python.c */
extern PyMethodDef moc_subproblem_functions[], moc_plant_functions[]; /* python_subproblem.c, plant.c */

typedef struct {
    parameter is;
    size_t offset;
} field;

/* Fill an object's fields from keywords. Returns false after an exception. */
bool moc_fill(PyObject *keywords, const field *fields, int count, Arm *self);

#endif
