/* A disk that takes only half of the Nth write to a recording: preloaded into the recorder, since no
 * option of strace makes the kernel take less. SHORT_WRITE=N, counted over files named *.mcap.part. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

ssize_t write(int fd, const void *data, size_t size) {
  static ssize_t (*real)(int, const void *, size_t);
  static int count;
  if (!real) real = (ssize_t (*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t length = readlink(link, path, sizeof path - 1);
  const char *wanted = getenv("SHORT_WRITE"), *ending = ".mcap.part";
  if (length > 10 && wanted && !memcmp(path + length - 10, ending, 10))
    if (__sync_add_and_fetch(&count, 1) == atoi(wanted) && size > 1) size /= 2;
  return real(fd, data, size);
}
