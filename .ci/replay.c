// Calls a library's entries as they were called on another machine, and compares what they write: for systems that are
// emulated without a Python. `replay LIBRARY LEVEL CALLS`; .ci/run_emulated.py writes the calls.
//
// A file has, for each call, in numbers of 8 bytes: the length of the entry's name, and the name; the number of
// work-groups; the length of the launch, and the launch; the number of its buffers. For each buffer: its slot's offset in
// the launch; its size; its bytes before the call; its bytes after it.

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#define REASON() "the system refuses it"
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#define REASON() dlerror()
#endif

#define MOST_BUFFERS 64
#define ALIGNMENT 64

typedef void entry_t(const unsigned char *launch, int64_t first_group, int64_t end_group);

static FILE *calls;

static int read_number(int64_t *number) { return fread(number, sizeof *number, 1, calls) == 1; }

static unsigned char *read_bytes(const int64_t size)
{
    unsigned char *bytes = malloc(size + 2 * ALIGNMENT);
    bytes += ALIGNMENT - (uintptr_t)bytes % ALIGNMENT;
    if (fread(bytes, 1, size, calls) != (size_t)size) {
        printf("the file of calls ends too early\n");
        exit(2);
    }
    bytes[size] = 0;
    return bytes;
}

int main(const int count, char **words)
{
    void *library = count == 4 ? OPEN(words[1]) : NULL;
    calls = count == 4 ? fopen(words[3], "rb") : NULL;
    if (!library || !calls) {
        printf("%s\n", calls ? REASON() : "replay LIBRARY LEVEL CALLS");
        return 2;
    }
    int (*ask_level)(void) = (int (*)(void))FIND(library, "clbvh_level");
    printf("level of the processor: %d; %s\n", ask_level(), (const char *)FIND(library, "clbvh_facts"));

    int64_t length, group_count, buffer_count, call_count = 0, compared = 0, differing = 0;
    while (read_number(&length)) {
        char name[1024];
        snprintf(name, sizeof name, "%s_%s", words[2], (char *)read_bytes(length));
        read_number(&group_count);
        read_number(&length);
        unsigned char *launch = read_bytes(length), *buffers[MOST_BUFFERS], *expected[MOST_BUFFERS];
        int64_t sizes[MOST_BUFFERS], offset;
        read_number(&buffer_count);
        for (int64_t i = 0; i < buffer_count; i++) {
            read_number(&offset);
            read_number(&sizes[i]);
            buffers[i] = read_bytes(sizes[i]);
            expected[i] = read_bytes(sizes[i]);
            memcpy(launch + offset, &buffers[i], sizeof buffers[i]);
        }
        entry_t *entry = (entry_t *)FIND(library, name);
        if (!entry) {
            printf("no entry %s\n", name);
            return 2;
        }
        entry(launch, 0, group_count);
        for (int64_t i = 0; i < buffer_count; i++) {
            for (int64_t byte = 0; byte < sizes[i]; byte++) {
                differing += buffers[i][byte] != expected[i][byte];
            }
            compared += sizes[i];
        }
        call_count++;
    }
    printf("%lld calls, %lld bytes, %lld differ\n", (long long)call_count, (long long)compared, (long long)differing);
    return call_count == 0 || differing != 0;
}
