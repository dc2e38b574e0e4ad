/* Cells as child processes on one machine. The parent opens no device. It starts `program train
 * SCENE --cell ID` in free slots, reads the progress of each from the last lines of its
 * metrics.jsonl, and collects the done-files. Every child reads cells/jobs.jsonc, the resolved
 * options of the parent.
 *
 * A child leads its own process group, so Ctrl-C reaches only the parent. The parent passes it on
 * as SIGTERM once and waits. If the parent dies, the kernel sends SIGTERM to its children.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/jobs.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <jansson.h>

#include "core/device/dev.h"
#include "core/machine.h"
#include "core/pool.h"
#include "train/base/config.h"
#include "train/base/result.h"
#include "train/base/schedule.h"
#include "train/coarse.h"
#include "train/done.h"
#include "train/expect.h"
#include "train/run.h"
#include "train/train_scene.h"

enum { JOBS_TAIL_BYTES = 8192, JOBS_POLL_MS = 200, JOBS_ARGS_MAX = 20 };

/* ---- the list ---- */

const char *jobs_state_name(enum jobs_state s)
{
    static const char *const names[] = {"new", "started", "done"};
    return names[s];
}

static enum err_code jobs_dir(const char *scene_dir, const struct train_config *cfg, const char *id,
                              char out[FILE_PATH_MAX], struct err *e)
{
    char cells[FILE_PATH_MAX];
    enum err_code rc = file_join(cells, cfg->output ? cfg->output : scene_dir, "cells", e);
    return rc ? rc : file_join(out, cells, id, e);
}

static enum err_code jobs_fill(const struct train_scene *s, const struct run_cell *job,
                               struct jobs_cell *out, struct err *e)
{
    struct schedule schedule[TRAIN_LEVELS_MAX];
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    enum err_code rc = schedule_make(job->cfg, job->n_images, &job->cell, schedule, e);
    if (!rc)
        rc = jobs_dir(s->dir, s->cfg, job->cell.id, dir, e);
    if (!rc)
        rc = file_join(path, dir, "done.json", e);
    if (rc)
        return rc;
    memcpy(out->id, job->cell.id, sizeof out->id);
    out->photos = job->n_images;
    const uint32_t n = (uint32_t)job->cfg->level_count;
    out->n_turns = job->cfg->level_order == SCHEDULE_BOTH ? 2 * n - 1 : n;
    for (uint32_t l = 0; l < n; l++) {
        out->steps[schedule[l].turn - 1] = schedule[l].steps;
        if (out->n_turns == n || l + 1 == n)
            continue;
        const struct schedule again = schedule_again(&schedule[l], &schedule[l + 1], job->cfg);
        out->steps[again.turn - 1] = again.steps;
    }
    out->state = file_exists(path) ? JOBS_DONE : JOBS_NEW;
    rc = file_join(path, dir, "resume.ckpt", e);
    if (!rc && file_exists(path))
        out->state = JOBS_STARTED;
    return rc;
}

/* A list in the making. */
struct jobs_listing {
    struct train_scene scene;
    bool needs;
    size_t n_around; /* most Gaussians of the coarse model that the cells begin from */
    struct jobs_list *out;
};

static enum err_code jobs_add(struct jobs_listing *l, const struct run_cell *job, struct err *e)
{
    struct jobs_cell *c = &l->out->cells[l->out->n_cells++];
    struct expect x;
    enum err_code rc = jobs_fill(&l->scene, job, c, e);
    if (rc || !l->needs)
        return rc;
    rc = expect_cell(job, l->n_around, &x, e);
    if (rc)
        return err_add(e, "cell %s", c->id);
    c->memory_bytes = x.memory_bytes;
    c->cpu_s = x.cpu_s;
    return ERR_OK;
}

/* The coarse model: in the list where that is asked for, else what the cells get of it. */
static enum err_code jobs_coarse(struct jobs_listing *l, struct err *e)
{
    const struct train_config *cells = l->scene.cfg;
    struct run_cell all = {.cfg = cells, .scene = &l->scene.scene}, job;
    struct train_config cfg;
    struct expect x;
    if (!coarse_wanted(cells, l->scene.n_planned) || !(l->needs || cells->coarse_only))
        return ERR_OK;
    enum err_code rc = train_scene_whole(&l->scene, &all, e);
    if (rc)
        return rc;
    coarse_job(&all, "", &cfg, &job);
    if (cells->coarse_only)
        return jobs_add(l, &job, e);
    rc = expect_cell(&job, 0, &x, e);
    l->n_around = cells->coarse_start ? x.gaussians[0] : 0;
    return rc;
}

enum err_code jobs_list(const char *scene_dir, const char *plan, const struct train_config *cfg,
                        bool needs, struct jobs_list *out, struct err *e)
{
    struct jobs_listing l = {.needs = needs, .out = out};
    struct train_scene *s = &l.scene;
    *out = (struct jobs_list){0};
    enum err_code rc = train_scene_open(scene_dir, plan, cfg, s, e);
    if (!rc)
        out->cells = mem_array(s->n_cells, sizeof *out->cells);
    if (!rc && !out->cells)
        rc = err_set(e, ERR_MEM, "train: out of memory for %zu cells", s->n_cells);
    if (!rc)
        rc = jobs_coarse(&l, e);
    for (size_t i = 0; !rc && !cfg->coarse_only && i < s->n_cells; i++) {
        struct run_cell job = {.cfg = cfg, .scene = &s->scene};
        rc = train_scene_cell(s, s->cells[i], &job, e);
        if (!rc)
            rc = jobs_add(&l, &job, e);
    }
    train_scene_close(s);
    if (rc)
        jobs_list_free(out);
    return rc;
}

void jobs_list_free(struct jobs_list *l)
{
    mem_free(l->cells);
    *l = (struct jobs_list){0};
}

size_t jobs_fit(size_t n_cells, double cell_bytes, size_t n_cores, double memory_bytes)
{
    size_t most = n_cells < n_cores ? n_cells : n_cores;
    double room = cell_bytes > 0.0 ? floor(memory_bytes / cell_bytes) : (double)most;
    size_t n = room < (double)most ? (size_t)fmax(room, 0.0) : most;
    return n > 0 ? n : 1;
}

enum err_code jobs_at_once(const struct train_config *cfg, const struct jobs_list *list,
                           size_t *out, struct err *e)
{
    struct dev dev;
    double cell_bytes = 0.0;
    size_t memory = 0;
    *out = 1;
    for (size_t i = 0; i < list->n_cells; i++)
        cell_bytes = fmax(cell_bytes, list->cells[i].memory_bytes);
    enum err_code rc = machine_memory_parse(cfg->memory, machine_memory(), &memory, e);
    if (rc || list->n_cells < 2)
        return rc;
    for (const char *c = cfg->device; *c; c++) /* a list of devices: one job each */
        *out += *c == ',';
    if (*out > 1)
        return ERR_OK;
    rc = dev_open(cfg->device, &dev, e);
    if (rc)
        return rc;
    if (dev.is_cpu)
        *out = jobs_fit(list->n_cells, cell_bytes,
                        cfg->threads ? (size_t)cfg->threads : pool_cores(), (double)memory);
    dev_close(&dev);
    return ERR_OK;
}

/* ---- one child ---- */

enum jobs_phase { JOBS_WAITING, JOBS_RUNNING, JOBS_GOOD, JOBS_FAILED };

struct jobs_child {
    const struct jobs_cell *cell;
    enum jobs_phase phase;
    pid_t pid;
    size_t slot;
    char dir[FILE_PATH_MAX];
    uint64_t steps, steps_done;
    uint32_t level; /* 1-based, 0 = nothing was written yet */
    double psnr_db;
};

struct jobs {
    const char *program, *scene_dir;
    const struct train_config *cfg;
    char config_path[FILE_PATH_MAX];
    struct jobs_child *child;
    size_t n, slots, running, good, failed;
    bool told; /* children were asked to stop */
    struct err first;
};

/* Entry `slot` of a comma-separated list, wrapping round. */
static void jobs_device(const char *list, size_t slot, char *out, size_t room)
{
    size_t n = 1, at = 0;
    for (const char *c = list; *c; c++)
        n += *c == ',';
    for (at = slot % n; at; at--)
        list = strchr(list, ',') + 1;
    snprintf(out, room, "%.*s", (int)strcspn(list, ","), list);
}

/* Runs between fork and exec: async-signal-safe calls only. */
static void jobs_become(const char *const argv[], int log_fd, pid_t parent)
{
    int null_fd = open("/dev/null", O_RDONLY);
    setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) /* it died before the line above */
        _exit(1);
    if (dup2(null_fd, STDIN_FILENO) < 0 || dup2(log_fd, STDOUT_FILENO) < 0 ||
        dup2(log_fd, STDERR_FILENO) < 0)
        _exit(126);
    union { /* exec promises not to write to them, in a type older than const */
        const char *const *from;
        char *const *to;
    } args = {.from = argv};
    execv(argv[0], args.to);
    _exit(127);
}

static enum err_code jobs_start(struct jobs *j, struct jobs_child *c, struct err *e)
{
    char log[FILE_PATH_MAX], threads[32], device[128];
    size_t all = j->cfg->threads ? (size_t)j->cfg->threads : pool_cores(), each = all / j->slots;
    snprintf(threads, sizeof threads, "%zu", each ? each : (size_t)1);
    jobs_device(j->cfg->device, c->slot, device, sizeof device);
    const char *argv[JOBS_ARGS_MAX] = {
        j->program, "train", j->scene_dir, "--config", j->config_path, "--cell", c->cell->id,
        "--jobs",   "1",     "--threads",  threads,    "--device",     device,   NULL};
    enum err_code rc = file_mkdir(c->dir, e);
    if (!rc)
        rc = file_join(log, c->dir, "train.log", e);
    if (rc)
        return rc;
    int fd = open(log, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0)
        return err_errno(e, ERR_IO, "%s: cannot open", log);
    pid_t parent = getpid();
    c->pid = fork();
    if (c->pid == 0)
        jobs_become(argv, fd, parent);
    int why = errno;
    close(fd);
    errno = why;
    if (c->pid < 0)
        return err_errno(e, ERR_IO, "cannot start another process");
    setpgid(c->pid, c->pid); /* whichever of the two comes first */
    c->phase = JOBS_RUNNING;
    j->running++;
    return ERR_OK;
}

/* The last bytes of a file, from a line's start; "" when there is none. */
static void jobs_tail(const char *dir, const char *name, char out[JOBS_TAIL_BYTES])
{
    char path[FILE_PATH_MAX];
    struct err ignored;
    out[0] = '\0';
    FILE *f = file_join(path, dir, name, &ignored) ? NULL : fopen(path, "rb");
    if (!f)
        return;
    long size = fseek(f, 0, SEEK_END) ? 0 : ftell(f);
    long from = size > JOBS_TAIL_BYTES - 1 ? size - (JOBS_TAIL_BYTES - 1) : 0;
    size_t n = fseek(f, from, SEEK_SET) ? 0 : fread(out, 1, JOBS_TAIL_BYTES - 1, f);
    out[n] = '\0';
    fclose(f);
    char *line = from > 0 ? strchr(out, '\n') : NULL;
    if (line)
        memmove(out, line + 1, strlen(line + 1) + 1);
}

/* How far a child is, by the last whole "step" line of its metrics. */
static void jobs_look(struct jobs_child *c)
{
    char text[JOBS_TAIL_BYTES], *end;
    jobs_tail(c->dir, "metrics.jsonl", text);
    while ((end = strrchr(text, '\n'))) {
        *end = '\0';
        char *line = strrchr(text, '\n');
        line = line ? line + 1 : text;
        json_t *o = strstr(line, "\"event\":\"step\"") ? json_loads(line, 0, NULL) : NULL;
        json_int_t turn = json_integer_value(json_object_get(o, "turn"));
        if (turn >= 1 && turn <= (json_int_t)c->cell->n_turns) {
            c->level = (uint32_t)json_integer_value(json_object_get(o, "level"));
            c->psnr_db = json_number_value(json_object_get(o, "psnr_mean_db"));
            c->steps_done = (uint64_t)json_integer_value(json_object_get(o, "step"));
            for (json_int_t k = 0; k + 1 < turn; k++)
                c->steps_done += c->cell->steps[k];
            json_decref(o);
            return;
        }
        json_decref(o);
    }
}

/* What a child said last: its error line, else how it ended. */
static enum err_code jobs_failure(const struct jobs_child *c, int status, struct err *e)
{
    char text[JOBS_TAIL_BYTES], *at, *said = NULL;
    jobs_tail(c->dir, "train.log", text);
    for (at = text; (at = strstr(at, "error: ")); at++)
        said = at + strlen("error: ");
    if (said)
        said[strcspn(said, "\n")] = '\0';
    if (said && *said)
        return err_set(e, ERR_DATA, "cell %s: %s (%s/train.log)", c->cell->id, said, c->dir);
    if (WIFSIGNALED(status))
        return err_set(e, ERR_DATA,
                       "cell %s: killed by signal %d%s (%s/train.log); --resume goes on from its "
                       "last saved state",
                       c->cell->id, WTERMSIG(status),
                       WTERMSIG(status) == SIGKILL ? ", as the system does when memory is out" : "",
                       c->dir);
    return err_set(e, ERR_DATA, "cell %s: ended with code %d (%s/train.log)", c->cell->id,
                   WIFEXITED(status) ? WEXITSTATUS(status) : -1, c->dir);
}

/* ---- all of them ---- */

static void jobs_ended(struct jobs *j, struct jobs_child *c, int status)
{
    struct err e = {0};
    j->running--;
    c->phase = WIFEXITED(status) && !WEXITSTATUS(status) ? JOBS_GOOD : JOBS_FAILED;
    if (c->phase == JOBS_GOOD) {
        j->good++;
        c->steps_done = c->steps;
        log_info("train", "cell=%s complete, %zu of %zu", c->cell->id, j->good, j->n);
        return;
    }
    if (j->told) /* it was asked to stop: no failure */
        return;
    jobs_failure(c, status, &e);
    log_error("train", "%s", e.msg);
    if (!j->failed++)
        j->first = e;
}

static void jobs_reap(struct jobs *j)
{
    for (size_t i = 0; i < j->n; i++) {
        int status = 0;
        struct jobs_child *c = &j->child[i];
        if (c->phase == JOBS_RUNNING && waitpid(c->pid, &status, WNOHANG) == c->pid)
            jobs_ended(j, c, status);
    }
}

static size_t jobs_free_slot(const struct jobs *j)
{
    for (size_t s = 0; s < j->slots; s++) {
        bool taken = false;
        for (size_t i = 0; i < j->n; i++)
            taken = taken || (j->child[i].phase == JOBS_RUNNING && j->child[i].slot == s);
        if (!taken)
            return s;
    }
    return 0;
}

/* The longest of those that wait: begun last, it would run alone at the end. NULL: none waits. */
static struct jobs_child *jobs_longest(struct jobs *j)
{
    struct jobs_child *longest = NULL;
    for (size_t i = 0; i < j->n; i++) {
        struct jobs_child *c = &j->child[i];
        if (c->phase == JOBS_WAITING && (!longest || c->steps > longest->steps))
            longest = c;
    }
    return longest;
}

static void jobs_fill_slots(struct jobs *j)
{
    for (struct jobs_child *c; j->running < j->slots && (c = jobs_longest(j));) {
        struct err e = {0};
        c->slot = jobs_free_slot(j);
        if (!jobs_start(j, c, &e))
            continue;
        c->phase = JOBS_FAILED;
        err_add(&e, "cell %s", c->cell->id);
        log_error("train", "%s", e.msg);
        if (!j->failed++)
            j->first = e;
    }
}

static void jobs_tell(struct jobs *j)
{
    if (j->told)
        return;
    j->told = true;
    log_info("train", "stopping: %zu cells save their state", j->running);
    for (size_t i = 0; i < j->n; i++)
        if (j->child[i].phase == JOBS_RUNNING)
            kill(j->child[i].pid, SIGTERM);
}

static void jobs_show(struct jobs *j, struct progress *p)
{
    char note[160];
    size_t at = 0;
    uint64_t steps = 0;
    at += (size_t)snprintf(note, sizeof note, "%zu of %zu cells", j->good, j->n);
    for (size_t i = 0; i < j->n; i++) {
        struct jobs_child *c = &j->child[i];
        if (c->phase == JOBS_RUNNING) {
            jobs_look(c);
            if (at < sizeof note && c->level)
                at += (size_t)snprintf(note + at, sizeof note - at, ", %s level %u %.1f dB",
                                       c->cell->id, c->level, c->psnr_db);
        }
        steps += c->steps_done < c->steps ? c->steps_done : c->steps;
    }
    progress_step(p, steps, note);
}

static void jobs_loop(struct jobs *j)
{
    struct progress p;
    uint64_t total = 0;
    const struct timespec nap = {.tv_nsec = JOBS_POLL_MS * 1000000L};
    for (size_t i = 0; i < j->n; i++)
        total += j->child[i].steps;
    progress_start(&p, "train cells", total);
    for (;;) {
        if (signals_stopping())
            jobs_tell(j);
        else
            jobs_fill_slots(j);
        if (!j->running)
            break;
        nanosleep(&nap, NULL); /* a signal ends it early, as it should */
        jobs_reap(j);
        jobs_show(j, &p);
    }
    progress_end(&p, NULL);
}

/* The resolved options for all children; what each needs of its own comes after it on the line. */
static enum err_code jobs_write_config(struct jobs *j, struct err *e)
{
    char dir[FILE_PATH_MAX], share[32];
    struct train_config cfg = *j->cfg;
    json_t *o = NULL;
    size_t memory = 0, slots = j->slots ? j->slots : 1;
    enum err_code rc = machine_memory_parse(cfg.memory, machine_memory(), &memory, e);
    snprintf(share, sizeof share, "%zuM", memory / slots >> 20);
    cfg.memory = memory >> 20 < slots ? "1M" : share;
    if (!rc)
        rc = jobs_dir(j->scene_dir, j->cfg, "", dir, e);
    if (!rc)
        rc = file_mkdir(dir, e);
    if (!rc)
        rc = file_join(j->config_path, dir, "jobs.jsonc", e);
    if (!rc)
        rc = options_to_json(train_options(), &cfg, &o, e);
    if (!rc)
        rc = jsonc_write(j->config_path, o, e);
    json_decref(o);
    return rc;
}

static enum err_code jobs_collect(struct jobs *j, struct train_result *out, struct err *e)
{
    out->cells = mem_array(j->n, sizeof *out->cells);
    if (!out->cells)
        return err_set(e, ERR_MEM, "train: out of memory for %zu cells", j->n);
    for (size_t i = 0; i < j->n; i++) {
        if (j->child[i].phase != JOBS_GOOD)
            continue;
        enum err_code rc = done_read(j->child[i].dir, &out->cells[out->n_cells++], e);
        if (rc)
            return rc;
    }
    return ERR_OK;
}

static enum err_code jobs_prepare(struct jobs *j, const struct jobs_list *list, struct err *e)
{
    j->n = list->n_cells;
    j->slots = (size_t)j->cfg->jobs < j->n ? (size_t)j->cfg->jobs : j->n;
    j->child = mem_array(j->n, sizeof *j->child);
    if (!j->child)
        return err_set(e, ERR_MEM, "train: out of memory for %zu cells", j->n);
    for (size_t i = 0; i < j->n; i++) {
        struct jobs_child *c = &j->child[i];
        c->cell = &list->cells[i];
        for (uint32_t k = 0; k < c->cell->n_turns; k++)
            c->steps += c->cell->steps[k];
        enum err_code rc = jobs_dir(j->scene_dir, j->cfg, c->cell->id, c->dir, e);
        if (rc)
            return rc;
    }
    return jobs_write_config(j, e);
}

enum err_code jobs_run(const char *program, const char *scene_dir, const struct train_config *cfg,
                       struct train_result *out, struct err *e)
{
    double start_s = clock_s();
    struct jobs_list list;
    struct jobs *j = mem_array(1, sizeof *j);
    *out = (struct train_result){0};
    if (!j)
        return err_set(e, ERR_MEM, "train: out of memory");
    j->program = program;
    j->scene_dir = scene_dir;
    j->cfg = cfg;
    enum err_code rc = jobs_list(scene_dir, NULL, cfg, false, &list, e);
    if (!rc)
        rc = jobs_prepare(j, &list, e);
    if (rc)
        goto out;
    jobs_loop(j);
    rc = jobs_collect(j, out, e);
    out->seconds = clock_s() - start_s;
    out->peak_bytes = mem_peak_bytes();
    if (!rc && j->failed)
        rc = err_set(e, j->first.code,
                     "%s; %zu of %zu cells are complete, the same command with "
                     "--resume trains the others",
                     j->first.msg, j->good, j->n);
    else if (!rc && j->told)
        rc = err_set(e, ERR_CANCEL,
                     "stopped: %zu of %zu cells are complete; the same command with "
                     "--resume goes on",
                     j->good, j->n);
out:
    jobs_list_free(&list);
    mem_free(j->child);
    mem_free(j);
    return rc;
}
