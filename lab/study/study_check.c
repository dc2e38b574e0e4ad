/* Checks the records for a page. Their commit must be in the history of HEAD, so that their command
 * can be run again. They must be as long, and every row must have as many seeds, as their study
 * states (lab/study/studies.def).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include <jansson.h>

#include "core/base.h"
#include "lab/study/runs.h"
#include "lab/study/study.h"

extern char **environ;

static const struct check_study {
    const char *name;
    unsigned steps, seeds;
} check_studies[] = {
#define STUDY(name, steps, seeds) {name, steps, seeds},
#include "lab/study/studies.def"
#undef STUDY
};

enum { CHECK_WORDS_MAX = 4, CHECK_HASH_LEAST = 4 };
struct check_commits { /* of HEAD's history, sorted */
    char (*hash)[41];
    size_t n;
};

static const struct check_study *check_find(const char *name)
{
    for (size_t i = 0; i < sizeof check_studies / sizeof *check_studies; i++)
        if (!strcmp(check_studies[i].name, name))
            return &check_studies[i];
    return NULL;
}

/* ---- history ---- */

static int check_wait(pid_t pid)
{
    int status = -1;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR)
            return -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

/* What git in folder `dir` prints, from its beginning on. NULL: it fails, or cannot be run. */
static FILE *check_git(const char *dir, const char *const words[CHECK_WORDS_MAX])
{
    const char *argv[CHECK_WORDS_MAX + 4] = {"git", "-C", dir};
    posix_spawn_file_actions_t to;
    pid_t pid;
    FILE *out = tmpfile();
    int rc = !out || posix_spawn_file_actions_init(&to), status = -1;
    if (!rc) {
        memcpy(argv + 3, words, CHECK_WORDS_MAX * sizeof *argv);
        rc = posix_spawn_file_actions_adddup2(&to, fileno(out), STDOUT_FILENO) ||
             posix_spawn_file_actions_addopen(&to, STDERR_FILENO, "/dev/null", O_WRONLY, 0) ||
             posix_spawnp(&pid, argv[0], &to, NULL, (char **)(uintptr_t)argv, environ);
        posix_spawn_file_actions_destroy(&to);
    }
    if (!rc)
        status = check_wait(pid);
    if (out && status) {
        fclose(out);
        return NULL;
    }
    if (out)
        rewind(out);
    return out;
}

enum study_history study_history(const char *dir)
{
    static const char *const words[CHECK_WORDS_MAX] = {"rev-parse", "--is-shallow-repository"};
    char said[32] = "";
    FILE *out = check_git(dir, words);
    if (!out)
        return STUDY_HISTORY_NONE;
    const bool whole = fgets(said, sizeof said, out) && !strcmp(said, "false\n");
    fclose(out);
    return whole ? STUDY_HISTORY_WHOLE : STUDY_HISTORY_SHALLOW;
}

static int check_order(const void *a, const void *b)
{
    return strcmp(a, b);
}

/* ERR_DATA: HEAD has no history. */
static enum err_code check_read_history(const char *dir, struct check_commits *c, struct err *e)
{
    static const char *const words[CHECK_WORDS_MAX] = {"rev-list", "HEAD"};
    size_t room = 0;
    char line[64];
    FILE *out = check_git(dir, words);
    enum err_code rc = out ? ERR_OK : err_set(e, ERR_DATA, "%s: git lists no commits of HEAD", dir);
    while (!rc && fgets(line, sizeof line, out)) {
        if (c->n == room) {
            void *more = mem_resize(c->hash, c->n, room = 2 * room + 1024, sizeof *c->hash);
            if (!more) {
                rc = err_set(e, ERR_MEM, "chart: out of memory for %zu commits", room);
                break;
            }
            c->hash = more;
        }
        snprintf(c->hash[c->n++], sizeof *c->hash, "%.40s", line);
    }
    if (out)
        fclose(out);
    if (!rc && c->n)
        qsort(c->hash, c->n, sizeof *c->hash, check_order);
    return rc;
}

/* Does a commit of the history begin with `hash`? What git would take for an option or a name is no
 * hash. */
static bool check_in_history(const struct check_commits *c, const char *hash)
{
    const size_t n = strlen(hash);
    size_t lo = 0, hi = c->n;
    if (n < CHECK_HASH_LEAST || hash[strspn(hash, "0123456789abcdef")])
        return false;
    while (lo < hi) {
        const size_t mid = lo + (hi - lo) / 2;
        if (strcmp(c->hash[mid], hash) < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo < c->n && !strncmp(c->hash[lo], hash, n);
}

/* ---- length and seeds ---- */

/* The number behind an option of the record's command; NaN without it. */
static double check_option(const json_t *line, const char *option)
{
    size_t n = strlen(option);
    for (const char *at = runs_text(line, "command"); (at = strstr(at, option)); at += n) {
        char *end = NULL;
        double v =
            at[n] == ' ' ? strtod(at + n, &end) : (double)NAN; /* --seed, not --seed-ground */
        if (isfinite(v) && end > at + n)
            return v;
    }
    return (double)NAN;
}

static double check_steps(const json_t *line)
{
    double said = check_option(line, "--iterations");
    return isfinite(said) ? said : runs_number(line, "steps");
}

double study_seed(const json_t *line)
{
    double seed = check_option(line, "--seed");
    seed = isfinite(seed) ? seed : runs_number(line, "seed");
    return isfinite(seed) ? seed : 1.0;
}

size_t study_row_length(const char *row)
{
    const char *seed = strstr(row, " (seed ");
    return seed ? (size_t)(seed - row) : strlen(row);
}

bool study_same_row(const json_t *a, const json_t *b)
{
    if (strcmp(runs_text(a, "study"), runs_text(b, "study")) != 0) /* of most pairs */
        return false;
    const char *row_a = runs_text(a, "row"), *row_b = runs_text(b, "row");
    size_t n = study_row_length(row_a);
    return n == study_row_length(row_b) && !strncmp(row_a, row_b, n) &&
           !strcmp(runs_text(a, "what"), runs_text(b, "what"));
}

static size_t check_seeds(const json_t *lines, const json_t *line)
{
    size_t i, k, n = 0;
    json_t *a, *b;
    json_array_foreach(lines, i, a)
    {
        bool again = !study_same_row(a, line);
        for (k = 0; k < i && !again; k++) {
            b = json_array_get(lines, k);
            again = study_same_row(b, line) && study_seed(a) == study_seed(b);
        }
        n += !again;
    }
    return n;
}

static enum err_code check_line(const json_t *lines, const json_t *line, struct err *e)
{
    const char *study = runs_text(line, "study"), *row = runs_text(line, "row");
    const struct check_study *s = check_find(study);
    if (!s)
        return err_set(e, ERR_DATA, "study '%s' states no length: lab/study/studies.def has none",
                       study);
    double steps = check_steps(line);
    if (s->steps && !(steps >= s->steps))
        return err_set(e, ERR_DATA,
                       "study '%s', row '%s': %.0f steps, and the study states %u: measure it "
                       "again (lab/study.sh %s) or state another length in lab/study/studies.def",
                       study, row, isfinite(steps) ? steps : 0.0, s->steps, study);
    size_t seeds = s->seeds > 1 ? check_seeds(lines, line) : 1;
    if (seeds < s->seeds)
        return err_set(e, ERR_DATA,
                       "study '%s', row '%.*s': %zu seeds, and the study states %u: measure the "
                       "others (lab/study.sh %s) or state fewer in lab/study/studies.def",
                       study, (int)study_row_length(row), row, seeds, s->seeds, study);
    return ERR_OK;
}

enum err_code study_check(const json_t *lines, const char *history_dir, struct err *e)
{
    struct check_commits commits = {0};
    enum err_code rc = history_dir ? check_read_history(history_dir, &commits, e) : ERR_OK;
    size_t i;
    json_t *line;
    json_array_foreach(lines, i, line)
    {
        if (!rc)
            rc = check_line(lines, line, e);
        if (!rc && history_dir && !check_in_history(&commits, runs_text(line, "commit")))
            rc = err_set(e, ERR_DATA,
                         "study '%s', row '%s': commit '%s' is not in the history of HEAD, so "
                         "nobody can repeat it: measure it again (lab/study.sh %s)",
                         runs_text(line, "study"), runs_text(line, "row"),
                         runs_text(line, "commit"), runs_text(line, "study"));
    }
    mem_free(commits.hash);
    return rc;
}
