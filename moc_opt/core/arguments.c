/* Arguments of the binding: arrays, numbers, keywords that fill a struct, and packed records. */
#include "python.h"

PyObject *moc_done(call *c, PyObject *result)
{
    while (c->count > 0)
        PyBuffer_Release(&c->view[--c->count]); /* of a number: nothing */
    return result;
}

/* nn n n + n n + one of each length, in the order of the enum. */
static const struct {
    int nn, n, one;
    const char *words;
} lengths[] = {{0, 1, 0, "n"},          {0, 11, 10, "11 n + 10"}, {1, 13, 18, "n n + 13 n + 18"},
               {0, 14, 16, "14 n + 16"}, {0, 0, 0, "k"},           {0, 0, 0, "any"}};

/* Whether a length is the one that is asked for; n and k are bound by the first array that has them. */
static int fits(call *c, int wanted, Py_ssize_t length)
{
    if (wanted >= 0 || wanted == ANY)
        return wanted == ANY || length == wanted;
    if (wanted == K) {
        c->k = c->k < 0 ? length : c->k;
        return length == c->k;
    }
    int nn = lengths[-1 - wanted].nn, n = lengths[-1 - wanted].n, one = lengths[-1 - wanted].one;
    if (c->n == 0 && length >= n + one && length <= MOC_MAX_JOINTS * n + one)
        c->n = (int)(length - one) / n;
    return c->n > 0 && length == (nn * c->n + n) * c->n + one;
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

static int refuse(const call *c, const parameter *p)
{
    char rows[32], columns[32];
    say(c, p->rows, rows);
    say(c, p->columns, columns);
    PyErr_Format(PyExc_ValueError, "%s: give a %s array of float64 of shape (%s,%s%s)%s", p->name,
                 p->kind == STRIDED ? "writable" : p->kind == WRITE ? "writable, C-contiguous" : "C-contiguous", rows,
                 p->columns ? " " : "", p->columns ? columns : "", c->n > 0 ? "" : " for 1 to 16 joints");
    return 0;
}

static int take_array(call *c, int i, PyObject *given, const parameter *p)
{
    Py_buffer *view = &c->view[i];
    int flags = PyBUF_FORMAT | (p->kind == STRIDED ? PyBUF_STRIDES : PyBUF_C_CONTIGUOUS);

    if (PyObject_GetBuffer(given, view, p->kind == WRITE || p->kind == STRIDED ? flags | PyBUF_WRITABLE : flags) < 0) {
        PyErr_Clear();
        return refuse(c, p);
    }
    if (view->format == NULL || strcmp(view->format, "d") != 0 || view->ndim != (p->columns ? 2 : 1) ||
        (p->columns && !fits(c, p->columns, view->shape[1])) || !fits(c, p->rows, view->shape[0]))
        return refuse(c, p);
    c->array[i] = view->buf;
    return 1;
}

static int take_one(call *c, int i, PyObject *given, const parameter *p)
{
    c->array[i] = NULL;
    c->view[i].obj = NULL;
    if (p->kind != NUMBER && p->kind != WHOLE)
        return (p->kind == MAYBE && given == Py_None) || take_array(c, i, given, p);
    c->number[i] = PyFloat_AsDouble(given);
    return !(c->number[i] == -1.0 && PyErr_Occurred());
}

int moc_take(call *c, int n, const char *name, PyObject *const *args, Py_ssize_t count, const parameter *table,
             int wanted)
{
    c->n = n;
    c->k = -1;
    c->count = 0;
    if (count != wanted) {
        PyErr_Format(PyExc_TypeError, "%s takes %d arguments, %zd were given", name, wanted, count);
        return 0;
    }
    for (int i = 0; i < wanted; i++) {
        c->count = i + 1;
        if (!take_one(c, i, args[i], &table[i])) {
            moc_done(c, NULL);
            return 0;
        }
    }
    return 1;
}

/* --- fields of an object --- */

int moc_fill(PyObject *keywords, const field *fields, int count, Arm *self)
{
    Py_ssize_t size = keywords ? PyDict_Size(keywords) : 0;
    if (size != count) {
        PyErr_Format(PyExc_TypeError, "%d keywords are taken, %zd were given", count, size);
        return 0;
    }
    for (const field *f = fields; f < fields + count; f++) {
        PyObject *given = PyDict_GetItemString(keywords, f->is.name);
        void *to = (char *)self + f->offset;
        call c;
        if (given == NULL)
            PyErr_Format(PyExc_TypeError, "%s is missing", f->is.name);
        if (given == NULL || !moc_take(&c, self->arm.n, f->is.name, &given, 1, &f->is, 1))
            return 0;
        if (f->is.kind == NUMBER)
            *(double *)to = c.number[0];
        else if (f->is.kind == WHOLE)
            *(int *)to = whole(&c, 0);
        else
            memcpy(to, c.array[0], (size_t)rows_of(&c, 0) * sizeof(double));
        moc_done(&c, NULL);
    }
    return 1;
}
