// What the library for the host needs besides kernels: the processor's level.
//
// Compiled as C for the oldest processor of its kind, so that it can say that this one is too old for the rest.

#if defined(__x86_64__)

static void ask_processor(const unsigned leaf, const unsigned part, unsigned *b, unsigned *c, unsigned *d)
{
    unsigned a = leaf;
    *c = part;
    __asm__("cpuid" : "+a"(a), "=b"(*b), "+c"(*c), "=d"(*d));
}

// The number N of the level x86-64-vN that the processor and the system support ("System V ABI, AMD64 supplement").
__attribute__((visibility("default"))) int clbvh_level(void)
{
    unsigned b, c, d, more_b, more_c, more_d, extended_c;
    ask_processor(1, 0, &b, &c, &d);
    const unsigned of_v2 = 1u << 0 | 1u << 9 | 1u << 13 | 1u << 19 | 1u << 20 | 1u << 23;
    if ((c & of_v2) != of_v2) {
        return 1;
    }
    // FMA, MOVBE, OSXSAVE, AVX and F16C; then LZCNT; AVX2, BMI1 and BMI2; and the registers that the system keeps.
    const unsigned of_v3 = 1u << 12 | 1u << 22 | 1u << 27 | 1u << 28 | 1u << 29;
    ask_processor(0x80000001, 0, &b, &extended_c, &d);
    ask_processor(7, 0, &more_b, &more_c, &more_d);
    if ((c & of_v3) != of_v3 || !(extended_c & 1u << 5) || (more_b & 0x128) != 0x128) {
        return 2;
    }
    unsigned kept, upper;
    __asm__("xgetbv" : "=a"(kept), "=d"(upper) : "c"(0));
    if ((kept & 0x6) != 0x6) {
        return 2;
    }
    // AVX-512 F, DQ, CD, BW and VL.
    const unsigned of_v4 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
    return (more_b & of_v4) == of_v4 && (kept & 0xe0) == 0xe0 ? 4 : 3;
}

#else

__attribute__((visibility("default"))) int clbvh_level(void)
{
    return 0;
}

#endif

#if defined(_WIN32)

// Windows calls it when the library is loaded and unloaded, and wants no 0.
int DllMainCRTStartup(void *library, unsigned reason, void *reserved)
{
    return 1;
}

#endif
