// A double that counts what is done with it: the exported C compiled as C++ with this in front of it.
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

extern unsigned long operations;

struct Counted {
    double value;
    Counted() : value(0.0) {}
    template <typename T> Counted(T given) : value(static_cast<double>(given)) {}
    explicit operator bool() const { return value != 0.0; }
    explicit operator int() const { return static_cast<int>(value); }
    Counted operator-() const { return ++operations, Counted(-value); }
    Counted operator+() const { return *this; }
    Counted &operator+=(Counted b) { return ++operations, value += b.value, *this; }
    Counted &operator-=(Counted b) { return ++operations, value -= b.value, *this; }
    Counted &operator*=(Counted b) { return ++operations, value *= b.value, *this; }
    Counted &operator/=(Counted b) { return ++operations, value /= b.value, *this; }
};

#define OPERATOR(op) inline Counted operator op(Counted a, Counted b) { return ++operations, Counted(a.value op b.value); }
OPERATOR(+) OPERATOR(-) OPERATOR(*) OPERATOR(/)
#define COMPARISON(op) inline bool operator op(Counted a, Counted b) { return ++operations, a.value op b.value; }
COMPARISON(<) COMPARISON(>) COMPARISON(<=) COMPARISON(>=) COMPARISON(==) COMPARISON(!=)
#define FUNCTION(name) inline Counted name(Counted x) { return ++operations, Counted(::name(x.value)); }
FUNCTION(sqrt) FUNCTION(fabs) FUNCTION(sin) FUNCTION(cos)
#define FUNCTION_OF_TWO(name) \
    inline Counted name(Counted x, Counted y) { return ++operations, Counted(::name(x.value, y.value)); }
FUNCTION_OF_TWO(fmin) FUNCTION_OF_TWO(fmax) FUNCTION_OF_TWO(fmod)

#define double Counted
