/*
 * Runs a program as if on Linux 5.5: the newer system calls that look up a path do not exist, and the C library and
 * QEMU take the older ones instead. proot as Debian 12 has it (5.1.0) knows only those; a path in a
 * newer one would be looked up on this machine and not in the root folder.
 *
 *   older-kernel PROGRAM [ARGUMENT...]
 */
#include <errno.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <stddef.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

/* For this system call: there is none. For any other: go on with the next line. */
#define NONE(number) \
	BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (number), 0, 1), \
	BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | ENOSYS)

int main(int count, char **words)
{
	struct sock_filter rules[] = {
		BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
		NONE(SYS_statx),
		NONE(SYS_openat2),
		NONE(SYS_faccessat2),
		BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
	};
	struct sock_fprog filter = { sizeof rules / sizeof *rules, rules };

	if (count < 2) {
		fprintf(stderr, "older-kernel: expected a program to run\n");
		return 2;
	}
	if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) || prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter)) {
		perror("older-kernel: setting the filter");
		return 1;
	}
	execvp(words[1], words + 1);
	perror(words[1]);
	return 127;
}
