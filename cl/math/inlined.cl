// Every function is inlined into its caller, but for those that are CALLED or APART. By itself PoCL 3.0 calls the
// larger ones, once per box or triangle, which takes a third longer in the wide layouts.
//
// PORTABLE, if defined, excludes the built-in functions of compilers, and leaves functions as they are: Oclgrind stops
// at the markers that inlining leaves behind.
#if defined(PORTABLE)
#define INLINED static
#else
#define INLINED static inline __attribute__((always_inline))
#endif

// A function that the host has for floats and for doubles, by one name.
#if defined(ON_HOST)
#define OVERLOADED INLINED __attribute__((overloadable))
#else
#define OVERLOADED INLINED
#endif

// Large functions that pictures need in several places: inlined as all others, which takes 11 % less time for `studio`.
// CALLS as 1: called, which makes half as much code, for variants of the host's library that few pictures need.
#if CALLS
#define CALLED static __attribute__((noinline))
#else
#define CALLED INLINED
#endif

// Functions that CPUs always call, and whose callers need the registers. GPUs have registers for both, and keep what a
// function is given by its address in slow memory.
#if IS_GPU || defined(PORTABLE)
#define APART INLINED
#else
#define APART static __attribute__((noinline))
#endif

// Asks for memory before it is read or written; any address is allowed.
#if defined(__clang__) && (defined(__x86_64__) || defined(__aarch64__)) && !defined(PORTABLE)
#define WILL_READ(address) __builtin_prefetch(address, 0, 3)
#define WILL_WRITE(address) __builtin_prefetch(address, 1, 3)
#else
#define WILL_READ(address)
#define WILL_WRITE(address)
#endif
