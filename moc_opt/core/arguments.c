/* Checks and converts the arguments of calls from Python. */
#include "python.h"

/* The symbolic lengths of python.h, from N to ANY: coefficients of n^2, n and 1, and the text in messages. */
static const struct {
    int nn, n, one;
    const char *words;
} lengths[] = {{0, 1, 0, "n"},          {0, 11, 10, "11 n + 10"}, {1, 13, 18, "n^2 + 13 n + 18"},
               {0, 14, 16, "14 n + 16"}, {0, 0, 0, "k"},           {0, 0, 0, "any"}};

static npy_intp length_of(const call *c, int wanted)
{
    if (wanted >= 0 || wanted == K)
        return wanted == K ? c->k : wanted;
    return (lengths[-1 - wanted].nn * c->n + lengths[-1 - wanted].n) * c->n + lengths[-1 - wanted].one;
}

/* Whether an array has the wanted length. The first length that depends on n (or k) sets n (or k). */
static bool fits(call *c, int wanted, npy_intp length)
{
    if (wanted == K && c->k < 0)
        c->k = length;
    if (wanted < 0 && wanted > K && c->n == 0) {
        int n = lengths[-1 - wanted].n, one = lengths[-1 - wanted].one;
        c->n = length > one && length <= MOC_MAX_JOINTS * n + one ? (int)(length - one) / n : 0;
        if (c->n == 0)
            return false;
    }
    return wanted == ANY || length == length_of(c, wanted);
}

static void say(const call *c, int wanted, char text[32])
{
    if (wanted == N && c->n > 0)
        wanted = c->n;
    if (wanted < 0)
        PyOS_snprintf(text, 32, "%s", lengths[-1 - wanted].words);
    else
        PyOS_snprintf(text, 32, "%d", wanted);
}

static bool refuse(const call *c, const parameter *p)
{
    char rows[32], columns[32];
    say(c, p->rows, rows);
    say(c, p->columns, columns);
    PyErr_Format(PyExc_ValueError, "%s: give a %s array of float64 of shape (%s,%s%s)%s", p->name,
                 p->kind == STRIDED ? "writable" : p->kind == WRITE ? "writable, C-contiguous" : "C-contiguous", rows,
                 p->columns ? " " : "", p->columns ? columns : "", c->n > 0 ? "" : " for 1 to 16 joints");
    return false;
}

static bool take_array(call *c, int i, PyObject *given, const parameter *p)
{
    PyArrayObject *array = (PyArrayObject *)given;
    int flags = p->kind == WRITE     ? NPY_ARRAY_CARRAY
                : p->kind == STRIDED ? NPY_ARRAY_BEHAVED
                                     : NPY_ARRAY_CARRAY_RO;

    if (!PyArray_Check(given) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISNOTSWAPPED(array) ||
        !PyArray_CHKFLAGS(array, flags) || PyArray_NDIM(array) != (p->columns ? 2 : 1) ||
        (p->columns && !fits(c, p->columns, PyArray_DIM(array, 1))) || !fits(c, p->rows, PyArray_DIM(array, 0)))
        return refuse(c, p);
    c->as[i] = array;
    c->array[i] = PyArray_DATA(array);
    return true;
}

static bool take_one(call *c, int i, PyObject *given, const parameter *p)
{
    c->array[i] = NULL;
    if (p->kind != NUMBER && p->kind != WHOLE)
        return (p->kind == MAYBE && given == Py_None) || take_array(c, i, given, p);
    c->number[i] = PyFloat_AsDouble(given);
    return !(c->number[i] == -1.0 && PyErr_Occurred());
}

static bool make(call *c, int i, const parameter *p)
{
    npy_intp shape[2] = {length_of(c, p->rows), length_of(c, p->columns)};
    PyObject *array = PyArray_SimpleNew(p->columns ? 2 : 1, shape, NPY_DOUBLE);
    if (array == NULL)
        return moc_done(c, NULL) != NULL;
    c->as[i] = (PyArrayObject *)array;
    c->array[i] = PyArray_DATA(c->as[i]);
    c->end++;
    return true;
}

bool moc_take(call *c, int n, const char *name, PyObject *const *args, Py_ssize_t count, const parameter *table,
             int size)
{
    int wanted = size;

    while (wanted > 0 && table[wanted - 1].kind == MADE)
        wanted--;
    c->n = n;
    c->k = -1;
    c->made = c->end = wanted;
    if (count != wanted) {
        PyErr_Format(PyExc_TypeError, "%s takes %d arguments, %zd were given", name, wanted, count);
        return false;
    }
    for (int i = 0; i < size; i++)
        if (!(i < wanted ? take_one(c, i, args[i], &table[i]) : make(c, i, &table[i])))
            return false;
    return true;
}

PyObject *moc_done(call *c, PyObject *result)
{
    while (c->end > c->made)
        Py_DECREF(c->as[--c->end]);
    return result;
}

bool moc_fill(PyObject *keywords, const field *fields, int count, Arm *self)
{
    Py_ssize_t size = keywords ? PyDict_Size(keywords) : 0;
    if (size != count) {
        PyErr_Format(PyExc_TypeError, "the object takes %d keywords, %zd were given", count, size);
        return false;
    }
    for (const field *f = fields; f < fields + count; f++) {
        PyObject *given = PyDict_GetItemString(keywords, f->is.name);
        void *to = (char *)self + f->offset;
        call c;
        if (given == NULL)
            PyErr_Format(PyExc_TypeError, "%s is missing", f->is.name);
        if (given == NULL || !moc_take(&c, self->arm.n, f->is.name, &given, 1, &f->is, 1))
            return false;
        if (f->is.kind == NUMBER)
            *(double *)to = c.number[0];
        else if (f->is.kind == WHOLE)
            *(int *)to = whole(&c, 0);
        else
            memcpy(to, c.array[0], (size_t)rows_of(&c, 0) * sizeof(double));
    }
    return true;
}
