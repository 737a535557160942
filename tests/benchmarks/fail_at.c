/* A layer between a program and the disk that fails one chosen call.

   Loaded with LD_PRELOAD. Calls that create, write, flush, rename or remove something below
   the folder FAULT_ROOT are counted in the file FAULT_STATE, which all processes of a run
   share; the one whose turn it is fails with a chosen error, and leaves its name there. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/uio.h>
#include <unistd.h>

struct state {
    long count;   /* calls so far */
    long turn;    /* the call that fails, 0: none */
    long error;   /* errno of it */
    long lasting; /* whether all later calls that need space fail as well */
    char what[PATH_MAX + 32];
};

static struct state *state;
static const char *root;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("FAULT_STATE");
    root = getenv("FAULT_ROOT");
    int file = path && root ? open(path, O_RDWR | O_CLOEXEC) : -1;
    if (file < 0)
        return;
    void *found = mmap(NULL, sizeof *state, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (found != MAP_FAILED)
        state = found;
}

static int fails(const char *call, const char *path, int grows) {
    if (!state || !path || strncmp(path, root, strlen(root)))
        return 0;
    long turn = __sync_add_and_fetch(&state->count, 1);
    if (!state->turn || turn < state->turn || (turn > state->turn && !(state->lasting && grows)))
        return 0;
    if (turn == state->turn)
        snprintf(state->what, sizeof state->what, "%s %s", call, path);
    errno = (int)state->error;
    return 1;
}

static int file_fails(const char *call, int file, int grows) {
    char link[64], path[PATH_MAX];
    if (!state)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0)
        return 0;
    path[length] = 0;
    return fails(call, path, grows);
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) \
        real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)

#define WRITES(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC))

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(int, name, const char *, int, ...); \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        return WRITES(flags) && fails("open", path, flags & O_CREAT) ? -1 : real(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name) \
    int name(int folder, const char *path, int flags, ...) { \
        REAL(int, name, int, const char *, int, ...); \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        return WRITES(flags) && fails("open", path, flags & O_CREAT) \
                   ? -1 : real(folder, path, flags, mode); \
    }
OPENAT(openat)
OPENAT(openat64)

int mkdir(const char *path, mode_t mode) {
    REAL(int, mkdir, const char *, mode_t);
    return fails("mkdir", path, 1) ? -1 : real(path, mode);
}

ssize_t write(int file, const void *content, size_t size) {
    REAL(ssize_t, write, int, const void *, size_t);
    return file_fails("write", file, 1) ? -1 : real(file, content, size);
}

ssize_t writev(int file, const struct iovec *parts, int count) {
    REAL(ssize_t, writev, int, const struct iovec *, int);
    return file_fails("write", file, 1) ? -1 : real(file, parts, count);
}

#define PWRITE(name, offset) \
    ssize_t name(int file, const void *content, size_t size, offset at) { \
        REAL(ssize_t, name, int, const void *, size_t, offset); \
        return file_fails("write", file, 1) ? -1 : real(file, content, size, at); \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define TRUNCATE(name, offset) \
    int name(int file, offset size) { \
        REAL(int, name, int, offset); \
        return file_fails("truncate", file, 1) ? -1 : real(file, size); \
    }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

#define FLUSH(name) \
    int name(int file) { \
        REAL(int, name, int); \
        return file_fails("flush", file, 1) ? -1 : real(file); \
    }
FLUSH(fsync)
FLUSH(fdatasync)
FLUSH(syncfs)

int rename(const char *from, const char *to) {
    REAL(int, rename, const char *, const char *);
    return fails("rename", to, 0) ? -1 : real(from, to);
}

int renameat(int a, const char *from, int b, const char *to) {
    REAL(int, renameat, int, const char *, int, const char *);
    return fails("rename", to, 0) ? -1 : real(a, from, b, to);
}

int unlink(const char *path) {
    REAL(int, unlink, const char *);
    return fails("remove", path, 0) ? -1 : real(path);
}

int unlinkat(int folder, const char *path, int flags) {
    REAL(int, unlinkat, int, const char *, int);
    return fails("remove", path, 0) ? -1 : real(folder, path, flags);
}
