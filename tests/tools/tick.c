// tick LIBRARY IMAGE: run a policy in a native library for another processor; print the bits of its commands.
//
// check_wheels.py writes the image, words of 8 bytes: how many words are addresses, where they are, then the
// structures and arrays of a call. An address is stored as the place that it points to, in words.

#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>

enum { TICKS, CIRCUITS, OBSERVATIONS, COMMANDS, HEADER };

static int64_t words[1 << 20];

int main(int count, char **arguments) {
    if (count != 3) return 2;
    FILE *file = fopen(arguments[2], "rb");
    if (!file || !fread(words, 8, sizeof words / 8, file)) return 2;
    int64_t *image = words + 1 + words[0];
    for (int64_t i = 1; i <= words[0]; i++) image[words[i]] = (intptr_t)(image + image[words[i]]);
    void *library = dlopen(arguments[1], RTLD_NOW);
    if (!library) return fprintf(stderr, "%s\n", dlerror()), 1;
    void (*tick)(void *, void *, void *) = (void (*)(void *, void *, void *))dlsym(library, "rover_ncp_tick_lanes");
    // An array: its address, rows and lanes. Those of all ticks follow each other.
    int64_t *seen = image + image[OBSERVATIONS], *commands = image + image[COMMANDS];
    for (int64_t i = 0; i < image[TICKS]; i++) {
        tick(image + image[CIRCUITS], seen, commands);
        fwrite((void *)(intptr_t)commands[0], 8, commands[1] * commands[2], stdout);
        seen[0] += 8 * seen[1] * seen[2];
    }
    return 0;
}
