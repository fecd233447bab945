/* A wall clock that can be stepped while a process runs.

   Preloaded, it moves CLOCK_REALTIME for its process alone, by the seconds (a double) at the start of the file
   $PYTHON_FAULTS_CLOCKS/<process id>. The file begins as a copy of $PYTHON_FAULTS_CLOCKS/start, and that of a forked child with what
   its parent's holds. No other clock is moved, as none moves when somebody sets a machine's time. */

#define _GNU_SOURCE
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile double *offset_s = NULL;

static void open_own_file(double start)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%d", getenv("PYTHON_FAULTS_CLOCKS"), (int)getpid());
    int file = open(path, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (file < 0)
        return;
    if (write(file, &start, sizeof start) == sizeof start) {
        void *shared = mmap(NULL, sizeof start, PROT_READ, MAP_SHARED, file, 0);
        offset_s = shared == MAP_FAILED ? NULL : shared;
    }
    close(file);
}

static void go_on_in_child(void)
{
    open_own_file(offset_s == NULL ? 0.0 : *offset_s);
}

__attribute__((constructor)) static void begin(void)
{
    const char *folder = getenv("PYTHON_FAULTS_CLOCKS");
    char path[4096];
    double start = 0.0;
    if (folder == NULL)
        return;
    snprintf(path, sizeof path, "%s/start", folder);
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file >= 0) {
        if (read(file, &start, sizeof start) != sizeof start)
            start = 0.0;
        close(file);
    }
    open_own_file(start);
    pthread_atfork(NULL, NULL, go_on_in_child);
}

static long long offset_ns(void)
{
    return offset_s == NULL ? 0 : (long long)(*offset_s * 1e9);
}

static long long real_ns(void)
{
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_REALTIME, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec + offset_ns();
}

int clock_gettime(clockid_t clock, struct timespec *found)
{
    long result = syscall(SYS_clock_gettime, clock, found);
    if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        long long moved = found->tv_sec * 1000000000LL + found->tv_nsec + offset_ns();
        found->tv_sec = moved / 1000000000LL;
        found->tv_nsec = moved % 1000000000LL;
    }
    return (int)result;
}

int gettimeofday(struct timeval *restrict found, void *restrict zone)
{
    long long now = real_ns();
    (void)zone;
    found->tv_sec = now / 1000000000LL;
    found->tv_usec = now % 1000000000LL / 1000;
    return 0;
}

time_t time(time_t *found)
{
    time_t now = real_ns() / 1000000000LL;
    if (found != NULL)
        *found = now;
    return now;
}
